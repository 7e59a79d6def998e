"""Named configurations of the training."""

from __future__ import annotations

from simcore.errors import InputError
from trainer.config import NetworkConfig, TrainConfig

PRESETS: dict[str, TrainConfig] = {
    # What a good model takes on a few cores.
    "standard": TrainConfig(
        network=NetworkConfig(input_size=128, height_channel=True, targets="log_per_weight"),
        fusion_training="subsets",
        mirror=0.5,
    ),
    # As published: equalised depth alone, single pictures, ImageNet weights, full size, pictures tilted as seen.
    "paper": TrainConfig(pretrained=True, inclinations="as_seen"),
    # Minutes on one core, for demonstrations and checks.
    "quick": TrainConfig(
        network=NetworkConfig(
            input_size=64, trunk_width=0.25, hidden=(64,), height_channel=True, targets="log_per_weight"
        ),
        fusion_training="subsets",
        mirror=0.5,
        learning_rate=3e-3,
        epochs=12,
        pictures_per_epoch=2000,
    ),
}


def preset_config(name: str) -> TrainConfig:
    """A named configuration.

    Raises:
        InputError: unknown name.
    """
    if name not in PRESETS:
        raise InputError(f"unknown preset {name!r}: choose {', '.join(PRESETS)}", code="preset_unknown")
    return PRESETS[name]
