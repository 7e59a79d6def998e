"""Explanations that are no effects, and effects that two scenes at one distance cannot tell apart."""

from __future__ import annotations

NOT_EFFECTS = ("none", "unknown")
GROUPS: tuple[frozenset[str], ...] = (
    frozenset({"depth_scale", "depth_bias", "camera_translation"}),
    frozenset({"air_draft", "panel_tilt"}),
)
"""Declared beforehand; counted as one in the blind check and listed in every report that names one of them."""


def group_of(name: str) -> frozenset[str]:
    """The effects declared inseparable from one, itself included."""
    return next((group for group in GROUPS if name in group), frozenset({name}))
