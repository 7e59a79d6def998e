"""Whether a check is gone on with the catalogue of effects that it was begun with."""

from __future__ import annotations

from diagnosis.effect import Effect
from diagnosis.effects import catalogue
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import content_key
from diagnosis.simulation.sizes import nodes
from simcore.scenes import Scene, Setup


def catalogue_key() -> str:
    """SHA-256 of all effects: their sizes and places, how probable these are, and what they change; hexadecimal."""
    return content_key(effects={name: _of_effect(effect) for name, effect in catalogue().items()})


def _of_effect(effect: Effect) -> dict[str, object]:
    sizes = nodes(effect)
    return {
        "stage": effect.stage.value,
        "components": {name: repr(component) for name, component in effect.components.items()},
        "sizes": [dict(size) for size in sizes],
        "shares": [float(share) for share in effect.place_shares],
        "between": [[dict(one.place), {str(k): v for k, v in one.shares.items()}] for one in effect.between],
        "changed": [effect.apply(SimulationScene(Setup.nominal(scene)), size) for scene in Scene for size in sizes],
    }
