"""Which fabric each material number of a sweep stands for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.effects import get_effect
from diagnosis.extension import AppliedEffect, SimulatorExtension
from services.dataset.configuration import SweepConfiguration, digest
from services.dataset.extension import check_effects
from simcore.errors import InputError
from simcore.parameters import FabricParameters
from simcore.prior import FabricPrior, is_admissible
from simcore.sampling import DesignKind, RandomDesign, SobolDesign, UnitDesign
from simcore.sampling_tables import log_grid, read_fabric_list


@dataclass(frozen=True)
class FabricTable:
    """Fabrics by material number, as they are simulated and stored: rounded to float32.

    Attributes:
        prior: distribution that fabrics are drawn from.
        design: which points of it; None when the fabrics are listed.
        listed: the fabrics of a list or grid, float64, shape [materials, 7].
    """

    prior: FabricPrior
    design: UnitDesign | None
    listed: NDArray[np.float64] | None = None

    def parameters(self, materials: Sequence[int]) -> NDArray[np.float32]:
        """Fabric parameters, SI, float32, shape [len(materials), 7]; a shard names each fabric several times."""
        if self.listed is not None:
            return self.listed[np.asarray(materials, dtype=np.int64)].astype(np.float32)
        once, places = np.unique(np.asarray(materials, dtype=np.int64), return_inverse=True)
        return self.prior.sample_array(once.tolist(), design=self.design).astype(np.float32)[places]


def plan_sweep(
    *,
    design: str = "sobol",
    fabrics: Path | None = None,
    materials: int | None = None,
    simulator: Path | SimulatorExtension | Sequence[AppliedEffect] = (),
    **settings: Any,
) -> tuple[SweepConfiguration, FabricTable]:
    """Resolve a sweep from what the user gave.

    Args:
        design: ``sobol``, ``random``, ``grid`` or ``list``; a file of fabrics means ``list``.
        fabrics: CSV or JSON file of a ``list``.
        materials: number of fabrics; of a grid, the most; of a list, only the first so many.
        simulator: ``simulator.json`` of a diagnosis, what is in it, or its effects; none for the baseline.
        settings: the other fields of :class:`SweepConfiguration`.

    Raises:
        InputError: something cannot be used.
    """
    kind = DesignKind.LIST if fabrics is not None else DesignKind.parse(design)
    if kind is DesignKind.LIST and fabrics is None:
        raise InputError("design list needs the file of fabrics: --fabrics FILE", code="list_missing")
    if kind is not DesignKind.LIST and materials is None:
        raise InputError("say how many fabrics: --materials N", code="materials_missing")
    ranges = dict(settings.pop("ranges", None) or {})
    if fabrics is not None and DesignKind.parse(design) not in (DesignKind.SOBOL, DesignKind.LIST):
        raise InputError(
            f"--fabrics lists the fabrics, --design {design} draws them: give one of the two", code="options_exclude"
        )
    if kind is DesignKind.LIST and ranges:
        raise InputError(
            "--range bounds fabrics that are drawn, --fabrics lists them: give one of the two", code="options_exclude"
        )
    listed: NDArray[np.float64] | None = None
    if kind is DesignKind.LIST and fabrics is not None:
        listed = _listed(fabrics, materials)
    elif kind is DesignKind.GRID and materials is not None:
        listed = log_grid(FabricPrior.default(ranges).ranges, materials)
    count = materials if listed is None else len(listed)
    extension = SimulatorExtension.load(simulator) if isinstance(simulator, Path) else simulator
    if not isinstance(extension, SimulatorExtension):
        extension = SimulatorExtension(effects=tuple(extension))
    configuration = SweepConfiguration.resolve(
        materials=count,
        design=kind,
        ranges=ranges,
        fabrics_digest="" if listed is None else digest(listed),
        simulator=tuple(_whole(effect) for effect in extension.effects),
        pin_radius_m=extension.pin_radius_m,
        **settings,
    )
    _ = configuration.mesh  # an unusable resolution is told now
    check_effects(configuration)
    return configuration, _table(configuration, listed)


def _whole(effect: AppliedEffect) -> AppliedEffect:
    """With the whole of a place that is given in part: stores say what was simulated, not what it was called."""
    known = get_effect(effect.name)
    given = effect.size.keys() & known.places[0].keys()
    return (
        effect
        if len(given) in (0, len(known.places[0]))
        else effect.model_copy(update={"size": known.size(effect.size)})
    )


def _table(configuration: SweepConfiguration, listed: NDArray[np.float64] | None) -> FabricTable:
    prior = FabricPrior.default(configuration.ranges)
    if listed is not None:
        return FabricTable(prior, None, listed)
    random = configuration.design is DesignKind.RANDOM
    design: UnitDesign = RandomDesign(configuration.seed) if random else SobolDesign(configuration.seed)
    table = FabricTable(prior, design)
    table.parameters([0])  # empty ranges are told now
    return table


def _listed(path: Path, most: int | None) -> NDArray[np.float64]:
    fabrics: list[FabricParameters] = read_fabric_list(path)[:most]
    values = np.array([fabric.as_array() for fabric in fabrics])
    unstable = np.flatnonzero(~is_admissible(values, margin=1.0))
    if len(unstable):
        raise InputError(
            f"{path}, fabric {unstable[0] + 1}: no plate has these bendings; "
            "4 bending_bias must be at least (sqrt(bending_warp) - sqrt(bending_weft))^2 "
            "+ 0.04 sqrt(bending_warp bending_weft)",
            code="bending_inadmissible",
        )
    return values
