"""The model folder: `weights.safetensors` and `model.json`."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from simcore.errors import DrapemeterError, InputError
from simcore.parameters import ESTIMATED_NAMES, UNITS, read_json_object
from trainer.config import TrainConfig
from trainer.evaluate import Metrics
from trainer.intervals import IntervalTable
from trainer.network import DrapeNetwork
from trainer.outliers import OutlierModel
from trainer.shipped import META_FILE, WEIGHTS_FILE, is_model_folder
from trainer.targets import TargetScaling

FORMAT = "drapemeter-model/1"
_NETWORK, _OUTLIERS = "network.", "outliers."


@dataclass(frozen=True)
class TrainedModel:
    """Everything that an estimate needs, and how it came about.

    Attributes:
        provenance: where the data came from (the store's attributes) and what trained it; free-form JSON.
    """

    config: TrainConfig
    network: DrapeNetwork
    scaling: TargetScaling
    intervals: IntervalTable
    outliers: dict[str, OutlierModel]
    metrics: Metrics
    provenance: dict[str, Any] = field(default_factory=dict)
    _stated: str = field(default="", init=False, repr=False, compare=False)
    """The version of the folder that it was read from, as it is: of an earlier program's it would come out another."""

    @property
    def version(self) -> str:
        """Content hash of weights and meaning: equal versions give equal estimates."""
        return self._stated or model_version(save(self._tensors()), self._meta())

    def save(self, folder: str | Path) -> str:
        """Write the folder in one piece, replacing an earlier model there.

        Returns:
            The version of what is written; another one than the model's own where an earlier program wrote that.

        Raises:
            InputError: ``folder`` exists and is no model folder, or lies where nothing can be made.
            DrapemeterError: the disk is full, or the folder cannot be replaced; an earlier model there is kept.
        """
        target = Path(os.path.realpath(folder))
        check_target(target)
        weights, meta = save(self._tensors()), self._meta()
        version = model_version(weights, meta)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            fresh = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
        except OSError as error:
            raise InputError(
                f"{target}: cannot be written ({error.strerror}); name another folder", code="output_not_writable"
            ) from None
        try:
            (fresh / WEIGHTS_FILE).write_bytes(weights)
            text = json.dumps({**meta, "model_version": version}, indent=1, ensure_ascii=False)
            (fresh / META_FILE).write_text(text + "\n", encoding="utf-8")
            fresh.chmod(0o755)
        except OSError as error:
            shutil.rmtree(fresh, ignore_errors=True)
            raise DrapemeterError(
                f"{target}: cannot be written ({error.strerror}); what was there is as it was", code="model_not_written"
            ) from error
        try:
            _take_place(fresh, target)
        except OSError as error:
            raise DrapemeterError(
                f"{target}: cannot be replaced ({error.strerror}); the new model is in {fresh}",
                code="model_not_replaced",
            ) from error
        return version

    def __reduce__(self) -> tuple[Any, ...]:
        # As it is stored: smaller, and classes of torchvision need not be imported to read it.
        return (_from_stored, (self._meta(), save(self._tensors()), self._stated))

    def _tensors(self) -> dict[str, Tensor]:
        tensors = {_NETWORK + k: _stored(k, v, self.config) for k, v in self.network.state_dict().items()}
        for scene, model in self.outliers.items():
            tensors |= model.to_tensors(_OUTLIERS + scene)
        return tensors

    def _meta(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "config": self.config.to_json(),
            "outputs": {name: UNITS[name] for name in ESTIMATED_NAMES},
            "scaling": self.scaling.to_json(),
            "intervals": self.intervals.to_json(),
            "outlier_scenes": sorted(self.outliers),
            "metrics": self.metrics.to_json(),
            "provenance": self.provenance,
        }


def load_model(folder: str | Path) -> TrainedModel:
    """Read a model folder.

    Raises:
        InputError: no model there, another format, or a file that is damaged or belongs to another model.
    """
    place = Path(folder)
    if not is_model_folder(place):
        raise InputError(
            f"{place} holds no model ({META_FILE} and {WEIGHTS_FILE}): train one with `drapemeter train --store STORE "
            f"--out {place}`, or give another folder",
            code="model_missing",
        )
    meta = read_json_object(place / META_FILE, "model")
    if meta.get("format") != FORMAT:
        raise InputError(
            f"{place} is of format {meta.get('format')!r}, this version reads {FORMAT}: train it again",
            code="model_format",
        )
    weights = (place / WEIGHTS_FILE).read_bytes()
    stated = meta.pop("model_version", None)
    if model_version(weights, meta) != stated:
        raise InputError(
            f"{place}: contents and model_version {stated} disagree: the folder is damaged or mixed; train or copy it "
            "again",
            code="model_damaged",
        )
    try:
        return _from_stored(meta, weights, str(stated))
    except (SafetensorError, KeyError, TypeError, RuntimeError) as error:
        raise InputError(f"{place}: cannot be read as a model ({error})", code="model_damaged") from None


def _take_place(fresh: Path, target: Path) -> None:
    """Put a folder in another one's place; where that fails the other one is there again."""
    if not target.exists():
        fresh.replace(target)
        return
    aside = fresh.with_name(f"{fresh.name}-former")
    target.replace(aside)
    try:
        fresh.replace(target)
    except OSError:
        aside.replace(target)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def check_target(folder: Path) -> None:
    """Refuse to replace what is no model, or what holds more than one.

    Raises:
        InputError: a file, or a folder with other things in it.
    """
    if is_model_folder(folder):
        others = sorted({path.name for path in folder.iterdir()} - {META_FILE, WEIGHTS_FILE})
        if others:
            raise InputError(
                f"{folder} holds {others[0]} beside a model, which would be lost: give another folder",
                code="output_exists",
            )
    if folder.exists() and not is_model_folder(folder) and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} exists and holds no model: give another folder", code="output_exists")


def model_version(weights: bytes, meta: dict[str, Any]) -> str:
    """Hash of the weights file and the canonical JSON of everything else."""
    digest = hashlib.sha256(weights)
    digest.update(json.dumps(meta, sort_keys=True, separators=(",", ":")).encode())
    return digest.hexdigest()[:16]


def round_weights(network: DrapeNetwork) -> None:
    """Round the weights in place to what half precision holds; statistics and biases stay as they are."""
    with torch.no_grad():
        for name, tensor in network.state_dict().items():
            if _is_half(name, tensor):
                tensor.copy_(tensor.half().float())


def _is_half(name: str, tensor: Tensor) -> bool:
    return name.endswith("weight") and tensor.dim() > 1


def _stored(name: str, tensor: Tensor, config: TrainConfig) -> Tensor:
    half = config.half_precision_weights and _is_half(name, tensor)
    return (tensor.half() if half else tensor).contiguous()


def _from_stored(meta: dict[str, Any], weights: bytes, stated: str) -> TrainedModel:
    tensors = load(weights)
    config = TrainConfig.from_json(meta["config"])
    network = DrapeNetwork(config.network)
    state = {k.removeprefix(_NETWORK): v for k, v in tensors.items() if k.startswith(_NETWORK)}
    network.load_state_dict({k: v.float() if v.is_floating_point() else v for k, v in state.items()})
    network.eval()
    outliers = {s: OutlierModel.from_tensors(_OUTLIERS + s, tensors) for s in meta["outlier_scenes"]}
    model = TrainedModel(
        config,
        network,
        TargetScaling.from_json(meta["scaling"]),
        IntervalTable.from_json(meta["intervals"]),
        outliers,
        Metrics.from_json(meta["metrics"]),
        meta["provenance"],
    )
    object.__setattr__(model, "_stated", stated)  # a part of no other model that is made of this one
    return model
