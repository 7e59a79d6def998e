"""Whether a set's captures can be simulated with effects on, and which of these are in poses that have to be found."""

from __future__ import annotations

from capture.capture_set import CaptureSet
from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.extension import SimulatorExtension
from diagnosis.groups import group_of
from diagnosis.tasks.put_up import check_set_ups
from simcore.errors import InputError


def check_effects(captures: CaptureSet, extension: SimulatorExtension, resolution_m: float = 0.01) -> tuple[str, ...]:
    """Whether captures can be estimated with effects on, as far as the set's own file tells.

    Args:
        captures: the set; its pictures are not looked at.
        extension: the effects.
        resolution_m: wanted edge of a mesh cell.

    Returns:
        Names of effects that are not simulated for captures whose pose is found in their pictures: what they do to the
        panel's picture is in that pose.

    Raises:
        InputError: an effect is unknown or has no such size, the captures cannot be simulated, or there is nothing to
            simulate that is not in the poses.
    """
    extension.check()
    if not extension.effects and extension.pin_radius_m is None:
        raise InputError("the simulator file adds nothing to the simulation: leave it away", code="extension_empty")
    check_set_ups(captures, resolution_m)
    stated = [capture.camera_from_panel is not None for capture in captures.captures]
    in_poses = tuple(effect.name for effect in extension.effects if not all(stated) and _moves_panel(effect.name))
    if not any(stated) and len(in_poses) == len(extension.effects) and extension.pin_radius_m is None:
        raise InputError(
            f"{' and '.join(in_poses)}: the poses are found in the pictures, which have that in them; state "
            "camera_from_panel in the capture set, or estimate without effects",
            code="effects_in_poses",
        )
    return in_poses


def _moves_panel(name: str) -> bool:
    """The effect, or one that is declared inseparable from it, has the panel seen elsewhere than it is."""
    return any(get_effect(twin).stage is Stage.CAMERA for twin in group_of(name))
