"""The estimate itself, as it runs in the inference process."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from services.estimates import estimate_fields
from services.jobs.scratch import scratch_folder
from services.jobs.sent_pictures import load_sent
from services.jobs.task import Report
from services.model_folder import load_model
from simcore.errors import InputError


def estimate_pictures(
    document: str, pictures: Mapping[str, bytes], density: float, model: Path, *, report: Report
) -> dict[str, Any]:
    """Estimate the one fabric of a capture set that came over the wire.

    Args:
        document: its ``captures.json``.
        pictures: depth pictures by file name.
        density: of the fabric [kg/m²].
        model: folder of the estimator.
        report: not needed, an estimate takes a second.

    Returns:
        The fields of :class:`trainer.predict.Estimate` and what speaks against the poses, as JSON.

    Raises:
        InputError: pictures that show no cloth, do not fit the camera, or cannot be registered.
        MissingResourceError: the model cannot be read.
    """
    from capture.pose_notes import PoseNotes
    from capture.prepare import inputs_by_fabric, prepare_all

    estimator, notes = load_model(model), PoseNotes()
    with scratch_folder() as folder:
        try:
            captures = load_sent(folder, document, pictures).captures
            ((fabric, inputs),) = inputs_by_fabric(notes.heard(prepare_all(captures))).items()
        except InputError as error:
            # The caller knows names of fields, not of our folders.
            raise InputError(str(error).replace(f"{folder}/", ""), code=error.code) from None
    found = estimator.estimate(inputs, density)
    return {**estimate_fields(found, notes.of_fabric(fabric)), "model_version": found.model_version}
