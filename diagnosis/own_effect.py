"""How people add an effect of their own: a whole file as an example, and what its fields say."""

from __future__ import annotations

OWN_EFFECT = '''\
"""The magnets hold the cloth off the panel."""

from diagnosis.effect import SCALAR, Effect, Size, Stage, scalar
from diagnosis.scene import SimulationScene


def change(scene: SimulationScene, size: Size) -> SimulationScene:
    """All pins moved away from the panel."""
    pins = {name: (x, y, z + size[SCALAR]) for name, (x, y, z) in scene.setup.pins_m.items()}
    return scene.with_setup(scene.setup.with_pins(**pins))


EFFECT = Effect(
    name="pin_height",
    stage=Stage.SETUP,
    unit="m",
    components=scalar(0.002, 0.010),
    summary="The pinned corners are held off the panel by this length.",
    hook="setup.pins_m",
    source="Magnets and clips a few millimetres thick.",
    change=change,
)
'''
"""A whole file, ``pin_height.py``."""

FIELDS = {
    "`name`": "as in reports and on the command line; no other file has it",
    "`stage`": "where it sits, and with that what `change` may change: `mechanics` (`Stage.FABRIC`, "
    "`Stage.ENVIRONMENT`), `setup` and `mechanics` (`Stage.SETUP`), `camera` and `pose` (`Stage.CAMERA`), "
    "`sensor` (`Stage.SENSOR`)",
    "`unit`": "of its size, as it is printed; `change` converts it where it is not SI",
    "`components`": "what is believed of its size beforehand: `scalar(low, high)` for one number, called `magnitude`, "
    "with `signed=True` where both signs occur; `vector(names, low, high)`, and `vector=True` beside it, for a vector "
    "whose length is in the range. `change` is called with sizes outside the range, too: of one number from half of "
    "`low` to 1.3 times `high`, and more where it is sought as a second effect. Where larger ones cannot be, "
    "`scalar(low, high, most=1.0)` says so",
    "`summary`, `hook`, `source`": "for people: what it does; what it sets; where mechanism and numbers come from",
    "`change`": "the change itself, see below",
    "`places`, `where`": "may be left out: where or which way it acts, tried one after the other, as in `crease.py`, "
    "and what that means",
    "`odds`, `anywhere`": "may be left out: how probable the places are relative to each other; a function of random "
    "numbers that draws where the effect really is, where that may be between the places, for blind checks",
    "`between`, `alike`": "may be left out: places that are not simulated, because what it does there is about a "
    "mixture of what it does at others, as in `edge_curl.py`; how much alike it does at all places, from 0 to less "
    "than 1",
    "`vector`, `random_repeats`, `holds`, `white`, `vague`, `twin`, `vanishes_at_zero`, `fine`, `presses`, `share`": (
        "may be left out: `diagnosis/effect.py` says which effects need them"
    ),
}

HOW_TO_ADD = "\n".join(
    [
        "## Your own effect",
        "",
        "An effect is one file in `diagnosis/effects/`; "
        '`python -c "import diagnosis.effects as e; print(*e.__path__)"` says where that is. By being there it is in '
        "the catalogue, for every command that takes effects. This is all of `pin_height.py`:",
        "",
        "```python",
        f"{OWN_EFFECT}```",
        "",
        "| field | what it says |",
        "|---|---|",
        *(f"| {field} | {text} |" for field, text in FIELDS.items()),
        "",
        "`change(scene, size)` gets the scene without the effect and all components of the size by name, those of the "
        "place too: `size[SCALAR]` is the magnitude, in `unit`. The scene (`SimulationScene` in `diagnosis/scene.py`) "
        "holds `setup` (pins, sample, panel: metres; x to the right, y up, z towards the camera), `mechanics` "
        "(gravity, pressure, curvature and what else the solver knows: `simcore/mechanics.py`), `camera`, `pose` and "
        "`sensor`. It is frozen; what comes back is a new one, by `scene.with_setup`, `with_mechanics`, `with_pose`, "
        "`with_sensor` or `dataclasses.replace(scene, camera=...)`. Add to what is there, because two effects may be "
        "on together, and draw nothing at random: simulations are kept under the scene that comes out, so an edited "
        "file is simulated afresh by itself.",
        "",
        "Try it: `drapemeter simulate --scene stretch --parameters p.json --effect pin_height=0.005 --out drape.ply`; "
        "from then on `drapemeter diagnose` reckons with it. A file without `EFFECT` is refused (`effect_file`), and "
        "so are two files with one name (`effect_duplicate`).",
        "",
    ]
)
"""The section of the catalogue's page, Markdown."""
