"""Every choice of a training run, as frozen dataclasses that are saved inside the model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from simcore.errors import InputError

Targets = Literal["log", "log_per_weight"]
FusionTraining = Literal["single", "subsets"]
Inclinations = Literal["upright", "registered", "as_seen"]


@dataclass(frozen=True)
class NetworkConfig:
    """The network and what it sees.

    Attributes:
        input_size: edge of the square input [pixel]; a divisor of the store's 256.
        trunk_width: channels of the ResNet-18 trunk as a share of the usual 64-128-256-512.
        attention: one self-attention layer behind the trunk (paper).
        average_pooling: average pooling beside max pooling (paper).
        equalise: histogram equalisation of the height over the cloth (paper).
        height_channel: a second channel with the height in metres, which equalisation throws away (ours).
        use_density: give the density to the regressor (paper).
        targets: ``log`` - logarithms of the parameters; ``log_per_weight`` - logarithms of the parameters over the
            density, which is all that a static picture can show (see ``docs/decisions/003``).
        hidden: widths of the regressor's hidden layers.
        dropout: share of the fused features, and of the density beside them, dropped in training.
    """

    input_size: int = 256
    trunk_width: float = 1.0
    attention: bool = True
    average_pooling: bool = True
    equalise: bool = True
    height_channel: bool = False
    use_density: bool = True
    targets: Targets = "log"
    hidden: tuple[int, ...] = (256, 128)
    dropout: float = 0.1

    def __post_init__(self) -> None:
        if self.input_size < 32 or 256 % self.input_size:
            raise InputError(
                f"input size {self.input_size} must be 32, 64, 128 or 256 (a divisor of the store's 256 pixels)",
                code="input_size",
            )
        if not 0.05 <= self.trunk_width <= 2.0:
            raise InputError(f"trunk width {self.trunk_width} must be from 0.05 to 2", code="trunk_width")
        if not (self.equalise or self.height_channel):
            raise InputError("the network needs an input: switch on equalise or height_channel", code="no_channels")

    @property
    def channels(self) -> int:
        """Input channels."""
        return int(self.equalise) + int(self.height_channel)


@dataclass(frozen=True)
class AugmentConfig:
    """Image-space augmentation, in the order of the fields; each with the probability that a picture gets it.

    Attributes:
        thin_plate: thin-plate spline warp; ``thin_plate_scale`` is the shift of its control points [half pictures].
        perspective: ``perspective_scale`` is the largest shift of a corner [half pictures].
        rescale: scale within 1 ± ``rescale_share``, rotation within ± ``rotation_deg``, shift within ± ``shift_share``.
        blur: Gaussian, ``blur_sigma_px``, of the network's input.
        noise: Gaussian on the height, ``noise_std_m``.
        posterise: heights in steps of 512 mm / 2^bits.
        erase: one rectangle without data, ``erase_share`` of the picture.
    """

    thin_plate: float = 0.3
    perspective: float = 0.3
    rescale: float = 0.5
    blur: float = 0.3
    noise: float = 0.5
    posterise: float = 0.2
    erase: float = 0.3
    thin_plate_scale: float = 0.02
    perspective_scale: float = 0.04
    rescale_share: float = 0.03
    rotation_deg: float = 1.5
    shift_share: float = 0.02
    blur_sigma_px: tuple[float, float] = (0.3, 1.2)
    noise_std_m: float = 0.0007
    posterise_bits: tuple[int, int] = (6, 8)
    erase_share: tuple[float, float] = (0.002, 0.02)

    @classmethod
    def off(cls) -> AugmentConfig:
        """No augmentation at all."""
        return cls(thin_plate=0, perspective=0, rescale=0, blur=0, noise=0, posterise=0, erase=0)

    @property
    def active(self) -> bool:
        """Whether any of the seven can happen."""
        return any((self.thin_plate, self.perspective, self.rescale, self.blur, self.noise, self.posterise, self.erase))


@dataclass(frozen=True)
class TrainConfig:
    """One training run.

    Attributes:
        fusion_training: ``single`` - every picture alone, as the paper; ``subsets`` - each scene alone and both fused,
            from the same two passes through the trunk (ours).
        inclinations: ``upright`` - only the pictures that are not tilted; ``registered`` - the tilted ones too, heights
            over the tilted panel, in the tilted view's perspective; ``as_seen`` - the tilted ones with their slope
            (paper).
        mirror: share of the hanging pictures shown in the mirror; the scene is symmetric (ours).
        pretrained: start the trunk from ImageNet weights (see ``trainer.pretrained``).
        train_share, calibration_share: shares of the materials to learn from and to calibrate the intervals on; the
            rest is for testing.
        pictures_per_epoch: bound on the pictures of one epoch; 0 = all of the store's.
    """

    network: NetworkConfig = field(default_factory=NetworkConfig)
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    fusion_training: FusionTraining = "single"
    inclinations: Inclinations = "registered"
    mirror: float = 0.0
    pretrained: bool = False
    epochs: int = 20
    batch_size: int = 32
    learning_rate: float = 1e-3
    weight_decay: float = 0.01
    warmup_share: float = 0.05
    train_share: float = 0.8
    calibration_share: float = 0.1
    pictures_per_epoch: int = 0
    seed: int = 0
    threads: int = 1
    workers: int = 0
    half_precision_weights: bool = True

    def __post_init__(self) -> None:
        if self.epochs < 1 or self.batch_size < 2:
            raise InputError("at least one epoch and a batch of two pictures are needed", code="training_length")
        if not (0 < self.train_share < 1 and 0 < self.calibration_share < 1):
            raise InputError("shares of materials must lie between 0 and 1", code="split_shares")
        if self.train_share + self.calibration_share >= 1:
            raise InputError(
                f"train share {self.train_share} and calibration share {self.calibration_share} leave no materials to "
                "test on: let them sum to less than 1",
                code="split_shares",
            )
        if self.seed < 0 or self.pictures_per_epoch < 0:
            raise InputError("seed and pictures of an epoch cannot be negative", code="training_numbers")
        if not 0.0 <= self.mirror <= 1.0:
            raise InputError(f"mirror {self.mirror} must be a share from 0 to 1", code="mirror")
        if not (0 < self.learning_rate < math.inf and self.threads >= 1 and self.workers >= 0):
            raise InputError(
                "learning rate and threads must be positive and finite, workers not negative", code="training_rate"
            )

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
        return asdict(self)

    def with_values(self, values: Mapping[str, Any], network: Mapping[str, Any]) -> TrainConfig:
        """The same with some fields of its own and of its network replaced; None leaves a field as it is.

        Raises:
            InputError: an unusable value.
        """
        plain = self.to_json()
        plain["network"].update({key: value for key, value in network.items() if value is not None})
        return self.from_json({**plain, **{key: value for key, value in values.items() if value is not None}})

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> TrainConfig:
        """Back from :meth:`to_json`.

        Raises:
            InputError: a field that this version does not know.
        """
        return _build(cls, values)


T = TypeVar("T")


def _build(cls: type[T], values: dict[str, Any]) -> T:
    assert is_dataclass(cls)
    hints = get_type_hints(cls)
    unknown = set(values) - {f.name for f in fields(cls)}
    if unknown:
        raise InputError(
            f"training configuration has unknown fields {', '.join(sorted(unknown))}: another version wrote it",
            code="configuration_unknown_field",
        )
    return cls(**{name: _convert(hints[name], value) for name, value in values.items()})


def _convert(hint: Any, value: Any) -> Any:
    if is_dataclass(hint):
        assert isinstance(hint, type)
        return _build(hint, value)
    if get_origin(hint) is tuple:
        return tuple(value)
    if get_origin(hint) is Literal and value not in get_args(hint):
        raise InputError(f"{value!r} is none of {', '.join(get_args(hint))}", code="configuration_value")
    return value
