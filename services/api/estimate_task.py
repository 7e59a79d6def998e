"""The estimate itself, as it runs in the inference process."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from services.estimates import estimate_fields
from services.jobs.scratch import scratch_folder
from services.jobs.task import Report
from simcore.errors import InputError, MissingResourceError
from trainer.shipped import META_FILE, WEIGHTS_FILE

if TYPE_CHECKING:
    from trainer.predict import Estimator


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
    from capture.capture_set import CaptureSet
    from capture.pose_notes import PoseNotes
    from capture.prepare import inputs_by_fabric, prepare_all

    estimator, notes = _load(model), PoseNotes()
    with scratch_folder() as folder:
        for name, content in pictures.items():
            (folder / name).write_bytes(content)
        (folder / "captures.json").write_text(document, encoding="utf-8")
        try:
            captures = CaptureSet.load(folder, read_pictures=False).captures
            ((fabric, inputs),) = inputs_by_fabric(notes.heard(prepare_all(captures))).items()
        except InputError as error:
            # The caller knows names of fields, not of our folders.
            raise InputError(str(error).replace(f"{folder}/", ""), code=error.code) from None
    found = estimator.estimate(inputs, density)
    return {**estimate_fields(found, notes.of_fabric(fabric)), "model_version": found.model_version}


def _load(model: Path) -> Estimator:
    """The estimator of a folder, read again when its files have changed."""
    try:
        files = [(model / name).stat() for name in (META_FILE, WEIGHTS_FILE)]
    except OSError:
        files = []  # reading it says what is wrong
    return _read(model, tuple((file.st_mtime_ns, file.st_size) for file in files))


@lru_cache(maxsize=1)
def _read(model: Path, state: tuple[tuple[int, int], ...]) -> Estimator:
    """The estimator of a folder in one state of its files: when they were written [ns] and their sizes [byte]."""
    import torch

    from trainer.predict import Estimator

    torch.set_num_threads(1)  # the other cores are the jobs'
    try:
        return Estimator.load(model)
    except InputError as error:  # the server's fault, not the caller's
        raise MissingResourceError(str(error), code=error.code) from None
    except OSError as error:
        raise MissingResourceError(
            f"the server cannot read its model ({error.strerror}): let it read the folder of DRAPEMETER_MODEL",
            code="model_missing",
        ) from None
