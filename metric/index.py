"""An index of fabrics by drape: one matrix product answers a query."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metric.descriptor import FabricDescriptor
from metric.sketch import Sketched
from metric.uncertainty import means_and_errors
from simcore.errors import InputError
from simcore.scenes import Scene


@dataclass(frozen=True)
class IndexedDistance:
    """Distance of one indexed fabric from a query.

    Attributes:
        place: of the fabric in the index.
        distance: drape distance.
        standard_error: from the scatter between simulations (the sketch's 1 % not counted); None with one simulation.
    """

    place: int
    distance: float
    standard_error: float | None


class FabricIndex:
    """Descriptors of many fabrics, stacked.

    Args:
        backend: made the sketches.
        descriptors: one a fabric, all with as many renders in the same scenes.

    Raises:
        InputError: no fabrics, or descriptors of different form.
    """

    def __init__(self, backend: Sketched, descriptors: Sequence[FabricDescriptor]) -> None:
        forms = {tuple((scene, *d.sketches[scene].shape) for scene in sorted(d.sketches)) for d in descriptors}
        if len(forms) != 1:
            raise InputError(
                "an index needs at least one fabric, and equally many renders of each in the same scenes",
                code="index_uneven",
            )
        self.backend = backend
        self._rows: dict[Scene, NDArray[np.float32]] = {
            scene: np.concatenate([d.sketches[scene] for d in descriptors]) for scene in sorted(descriptors[0].sketches)
        }
        self._squares = {scene: np.einsum("ij,ij->i", rows, rows) for scene, rows in self._rows.items()}
        self._count = len(descriptors)

    def __len__(self) -> int:
        return self._count

    def query(self, reference: FabricDescriptor) -> list[IndexedDistance]:
        """Every fabric's drape distance from a reference, the nearest first.

        Raises:
            InputError: the reference was rendered in other scenes.
        """
        if set(reference.sketches) != set(self._rows):
            raise InputError("the reference was rendered in other scenes than the library", code="scenes_differ")
        distance, variance = np.zeros(self._count), np.zeros(self._count)
        for scene, rows in self._rows.items():
            own = reference.sketches[scene]
            squares = np.einsum("ij,ij->i", own, own)[:, None] + self._squares[scene] - 2.0 * (own @ rows.T)
            table = np.maximum(squares, 0.0) * self.backend.squared_distance_unit
            means, errors = means_and_errors(table.reshape(len(own), self._count, -1).transpose(1, 0, 2))
            distance += means / len(self._rows)
            variance += errors**2 / len(self._rows) ** 2
        errors = np.sqrt(variance)
        return [
            IndexedDistance(int(k), float(distance[k]), None if np.isnan(errors[k]) else float(errors[k]))
            for k in np.argsort(distance, kind="stable")
        ]
