"""Estimates of a fabric's six stiffnesses from normalised captures and its density."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from capture.normalise import CANONICAL_SAMPLE_M, NetworkInput, held_otherwise
from simcore.errors import InputError, MissingResourceError
from simcore.parameters import ESTIMATED_NAMES, LIMITS
from simcore.scenes import Scene
from trainer.config import AugmentConfig
from trainer.dataset import SCENES
from trainer.held import held_in_training
from trainer.inference import scene_names
from trainer.mirrored import fits_better_in_the_mirror, mirror_reason
from trainer.model import TrainedModel, load_model
from trainer.network import Features, fuse
from trainer.outliers import picture_statistics
from trainer.preprocess import network_images, resize
from trainer.shipped import DEFAULT_MODEL, is_model_folder
from trainer.targets import TargetScaling, similarity_shift

MOST_STANDARDISED = 4.0
"""The regressor is not believed further than this many spreads from the training materials' mean."""

PICTURES_AT_ONCE, COMBINATIONS_AT_ONCE = 32, 4096
"""What goes through the network together: memory does not grow with the number of repeats."""

SIZES_ALIKE = AugmentConfig().rescale_share
"""Samples whose sizes differ by no more, as a share, are seen together: a training rescales its pictures by as much."""

PRIOR_HALF_WIDTH = 2.0
"""Where the calibration materials were too few: the training materials' own mean ± 2 spreads."""


@dataclass(frozen=True)
class Estimate:
    """What the pictures and the density tell of a fabric.

    Attributes:
        parameters: the six of ``ESTIMATED_NAMES``, SI.
        intervals_90: lower and upper end, SI; cover the truth for 90 % of synthetic fabrics held out of training.
        intervals_calibrated: False where too few fabrics were held out for that: intervals are then as wide as what the
            network was trained on.
        out_of_distribution: the captures are unlike what the network was trained on; do not trust the intervals.
        reasons: in words, what of the set-up, the density or a picture that fits better in the mirror makes them so.
        out_of_distribution_score: largest distance from the training pictures over its border; 1 is the border. That
            of the density counts, too.
        picture_score: the same of the pictures alone.
        scenes: scenes the estimate rests on.
        model_version: of the network.
    """

    parameters: dict[str, float]
    intervals_90: dict[str, tuple[float, float]]
    out_of_distribution: bool
    out_of_distribution_score: float
    picture_score: float
    scenes: tuple[str, ...]
    model_version: str
    reasons: tuple[str, ...] = ()
    intervals_calibrated: bool = True


class _Extracted(NamedTuple):
    """Features of one picture, [channels], with the sample's scale (to a millionth), the outlier score, and whether it
    fits better in the mirror."""

    maximum: torch.Tensor
    mean: torch.Tensor
    scale: float
    score: float
    mirrored: bool


class Estimator:
    """A loaded model. Not bound to a thread; give each thread its own or guard it."""

    def __init__(self, model: TrainedModel) -> None:
        self.model = model
        self.model.network.eval()
        self.version = model.version
        self._held_m = held_in_training(model.provenance)

    @classmethod
    def load(cls, folder: str | Path | None = None) -> Estimator:
        """Load a model folder; None loads the one that ships with the package.

        Raises:
            InputError: no model there, or a damaged one.
            MissingResourceError: no folder was given and none ships.
        """
        if folder is None:
            if not is_model_folder(DEFAULT_MODEL):
                raise MissingResourceError(
                    "no model ships with this installation: train one with `drapemeter train --store STORE "
                    "--out model/` and give --model model/",
                    code="default_model_missing",
                )
            folder = DEFAULT_MODEL
        return cls(load_model(folder))

    @torch.no_grad()
    def estimate(self, inputs: Mapping[Scene | str, NetworkInput | Sequence[NetworkInput]], density: float) -> Estimate:
        """Estimate one fabric.

        Repeats are averaged: every combination of one picture a scene gives a prediction, and their logarithms are
        averaged. Samples that are not 0.5 m are converted by similarity (``trainer.targets.similarity_shift``); those
        whose sizes differ by more than :data:`SIZES_ALIKE` are estimated apart, and the estimates averaged.

        Args:
            inputs: normalised captures by scene, one or several of each; any subset of the scenes.
            density: [kg/m²].

        Raises:
            InputError: no pictures, pictures of no cloth, an unknown scene or an unusable density.
        """
        check_density(density)
        pictures = _by_scene(inputs)
        extracted = {scene: self._extract(scene, shown) for scene, shown in pictures.items()}
        alike = _of_like_size(extracted)
        parts = [self._predict(shown, density) for shown in alike]
        centre = np.mean([part[0] for part in parts], axis=0)
        low = np.mean([part[1] for part in parts], axis=0)
        high = np.mean([part[2] for part in parts], axis=0)
        seen = max(float(np.median([e.score for e in shown])) for shown in extracted.values())
        score = max(self.model.scaling.beyond(density), seen)
        reasons = self._reasons(pictures, extracted, density)
        values, lower, upper = (_within_limits(np.exp(logs)) for logs in (centre, low, high))
        return Estimate(
            parameters=dict(zip(ESTIMATED_NAMES, values, strict=True)),
            intervals_90=dict(zip(ESTIMATED_NAMES, zip(lower, upper, strict=True), strict=True)),
            out_of_distribution=score > 1.0 or bool(reasons),
            out_of_distribution_score=score,
            picture_score=seen,
            scenes=tuple(scene.value for scene in SCENES if scene in extracted),
            model_version=self.version,
            reasons=reasons,
            intervals_calibrated=all(self.model.intervals.promises(scene.value for scene in shown) for shown in alike),
        )

    def estimate_named(
        self, fabric: str, inputs: Mapping[Scene | str, NetworkInput | Sequence[NetworkInput]], density: float
    ) -> Estimate:
        """As :meth:`estimate`, of one of several fabrics.

        Raises:
            InputError: as there; the message names the fabric.
        """
        try:
            return self.estimate(inputs, density)
        except InputError as error:
            raise InputError(f"fabric {fabric!r}: {error}", code=error.code) from None

    def _reasons(
        self,
        pictures: Mapping[Scene, list[NetworkInput]],
        extracted: Mapping[Scene, list[_Extracted]],
        density: float,
    ) -> tuple[str, ...]:
        """In words, each once, what makes captures and density [kg/m²] unlike those of the training."""
        told: list[str | None] = []
        for one in (one for shown in pictures.values() for one in shown):
            told += [held_otherwise(one, self._held_m), *one.otherwise]
        told += [mirror_reason(scene, [one.mirrored for one in shown]) for scene, shown in extracted.items()]
        told.append(_density_beyond(self.model.scaling, density))
        return tuple(dict.fromkeys(text for text in told if text is not None))

    def _extract(self, scene: Scene, inputs: Sequence[NetworkInput]) -> list[_Extracted]:
        size = self.model.config.network.input_size
        heights = np.stack([np.where(i.mask, i.height, np.float32(0.0)) for i in inputs]).astype(np.float32)
        pictures = resize(torch.from_numpy(heights)[:, None], size)
        empty = np.flatnonzero(picture_statistics(pictures)[:, 0] <= 0.0)
        if len(empty):
            raise InputError(
                f"picture {empty[0] + 1} of {len(inputs)} of {scene.value} shows no cloth before the panel: check the "
                "capture and its pose",
                code="no_cloth",
            )
        features, scores = self._described(scene, pictures)
        mirrored = np.zeros(len(inputs), dtype=np.bool_)
        if scene is Scene.STRETCH:
            mirrored = fits_better_in_the_mirror(scores, self._described(scene, pictures.flip(-1))[1])
        scales = [round(one.length_scale, 6) for one in inputs]
        return [
            _Extracted(features.maximum[k], features.mean[k], scales[k], float(scores[k]), bool(mirrored[k]))
            for k in range(len(inputs))
        ]

    def _described(self, scene: Scene, pictures: torch.Tensor) -> tuple[Features, NDArray[np.float64]]:
        """Features of pictures [pictures, 1, H, W] and their outlier scores [pictures], inf where none was learnt."""
        parts = [
            self.model.network.extract(network_images(some, self.model.config.network))
            for some in torch.split(pictures, PICTURES_AT_ONCE)
        ]
        features = Features(*(torch.cat(channels) for channels in zip(*parts, strict=True)))
        if scene.value not in self.model.outliers:
            return features, np.full(len(pictures), math.inf)
        joined = torch.cat(list(features), dim=1).double().numpy()
        return features, self.model.outliers[scene.value].scores(joined, picture_statistics(pictures)).max(axis=1)

    def _predict(
        self, shown: Mapping[Scene, list[_Extracted]], density: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Log-parameters with their interval from the samples of one size or nearly, each float64 [6]."""
        scene_set = tuple(index for index, scene in enumerate(SCENES) if scene in shown)
        combinations = list(product(*(shown[SCENES[index]] for index in scene_set)))
        scaling = self.model.scaling
        encoded = float(scaling.encode_density(np.array(density)))
        starts = range(0, len(combinations), COMBINATIONS_AT_ONCE)
        found = [self._regress(combinations[k : k + COMBINATIONS_AT_ONCE], encoded) for k in starts]
        centre = torch.cat([mean for mean, _ in found]).mean(dim=0).numpy().clip(-MOST_STANDARDISED, MOST_STANDARDISED)
        spread = torch.cat([width for _, width in found]).mean(dim=0).numpy()
        half = self.model.intervals.half_widths(scene_names(scene_set), spread)
        low = np.where(np.isfinite(half), centre - half, np.minimum(centre, -PRIOR_HALF_WIDTH))
        high = np.where(np.isfinite(half), centre + half, np.maximum(centre, PRIOR_HALF_WIDTH))
        shift = similarity_shift(_mean_scale(shown) * CANONICAL_SAMPLE_M)
        logs = scaling.decode(np.stack([centre, low, high]), np.full(3, density)) + shift
        return logs[0], logs[1], logs[2]

    def _regress(
        self, combinations: Sequence[tuple[_Extracted, ...]], density: float
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Standardised means and spreads of pictures shown together, one a scene, each float64 [combinations, 6]."""
        maximum = torch.stack([torch.stack([e.maximum for e in c]) for c in combinations])
        mean = torch.stack([torch.stack([e.mean for e in c]) for c in combinations])
        present = torch.ones(maximum.shape[:2], dtype=torch.bool)
        standardised = torch.full((len(combinations),), density)
        found = self.model.network.regress(fuse(Features(maximum, mean), present), standardised)
        return found.mean.double(), found.log_spread.double().exp()


def check_density(density: float) -> None:
    """Raise :class:`InputError` for a density that no textile has."""
    low, high = LIMITS["density"]
    if not (math.isfinite(density) and low <= density <= high):
        raise InputError(
            f"density {density:g} kg/m² is outside {low:g} to {high:g} kg/m²: give kg/m², that is g/m² over 1000",
            code="parameter_out_of_range",
        )


def _density_beyond(scaling: TargetScaling, density: float) -> str | None:
    """In words, that a density [kg/m²] lies outside of those that were trained on; None inside."""
    if scaling.beyond(density) <= 1.0:
        return None
    low, high = scaling.densities()
    return f"the density {density:g} kg/m² is beyond the {low:.2g} to {high:.2g} that the network was trained on"


def _by_scene(
    inputs: Mapping[Scene | str, NetworkInput | Sequence[NetworkInput]],
) -> dict[Scene, list[NetworkInput]]:
    found: dict[Scene, list[NetworkInput]] = {}
    for name, shown in inputs.items():
        pictures = [shown] if isinstance(shown, NetworkInput) else list(shown)
        if pictures:
            found.setdefault(Scene.parse(str(name)), []).extend(pictures)
    if not found:
        raise InputError("no capture to estimate from: give at least one picture of one scene", code="no_captures")
    return found


def _of_like_size(extracted: Mapping[Scene, list[_Extracted]]) -> list[dict[Scene, list[_Extracted]]]:
    """Pictures whose samples' sizes agree to :data:`SIZES_ALIKE`, group by group from the smallest, by scene."""
    groups = []
    for scales in _alike(sorted({one.scale for found in extracted.values() for one in found})):
        chosen = {scene: [one for one in found if one.scale in scales] for scene, found in extracted.items()}
        groups.append({scene: found for scene, found in chosen.items() if found})
    return groups


def _alike(scales: list[float]) -> list[list[float]]:
    """Ascending scales, cut at the widest gap until each part's agree."""
    if scales[-1] <= scales[0] * (1.0 + SIZES_ALIKE):
        return [scales]
    cut = int(np.argmax(np.diff(np.log(scales)))) + 1
    return [*_alike(scales[:cut]), *_alike(scales[cut:])]


def _mean_scale(shown: Mapping[Scene, list[_Extracted]]) -> float:
    """Of every combination of one picture a scene the geometric mean, and of these again; of equal ones to the digit.

    Logarithms of parameters shift in proportion to the scale's: this shifts their mean as every combination its own.
    """
    scales = {one.scale for found in shown.values() for one in found}
    if len(scales) == 1:
        return scales.pop()
    return math.exp(float(np.mean([np.mean([math.log(one.scale) for one in found]) for found in shown.values()])))


def _within_limits(values: NDArray[np.float64]) -> list[float]:
    """Inside what :class:`~simcore.parameters.FabricParameters` accepts."""
    limits = np.array([LIMITS[name] for name in ESTIMATED_NAMES])
    return [float(v) for v in np.clip(values, limits[:, 0], limits[:, 1])]
