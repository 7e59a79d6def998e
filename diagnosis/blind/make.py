"""Capture sets whose cause is sealed: the label lies in a file of its own, its hash in the set."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from capture.capture_set import CAPTURES_FILE
from diagnosis.blind.same_catalogue import catalogue_key
from diagnosis.effect import SCALAR, Effect, Size
from diagnosis.effects import catalogue, get_effect
from diagnosis.groups import group_of
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.synthesis import DIAGNOSABLE, MISSTATED_ATTEMPTS, SynthesisPlan, make_capture_set, real_fabric
from renderer.atomic import write_atomically
from simcore.errors import InputError, SimulationError
from simcore.mechanics import Jitter
from simcore.mesh import GridMesh
from simcore.parameters import ESTIMATED_NAMES, FabricParameters
from simcore.prior import FabricPrior, is_admissible
from simcore.scenes import Scene, Setup

BLIND_FORMAT = "drape-blind-check/1"
MANIFEST_FILE = "blind.json"
LABELS_FOLDER = "labels"
KINDS = ("named", "none", "wrong_parameter", "two", "withheld")
INVISIBLE = ("panel_friction",)
"""Effects that two scenes do not show (see ``docs/diagnosis.md``): not drawn."""
SHUFFLED: Final = MappingProxyType({"named": 13, "none": 4, "wrong_parameter": 3, "two": 3, "withheld": 2})
"""Kinds in every so many cases, in random order."""
BLIND_JITTER: Final = Jitter(1.0, 0.0004, 0.03)
"""Between repeats."""
SHARED_BY = 8
"""So many cases in a row share the drapes that have no effect on the cloth."""


@dataclass(frozen=True)
class BlindPlan:
    """What a blind check holds.

    Attributes:
        cases: number of capture sets.
        seed: of everything.
        fabrics, repeats: a set's fabrics, and its captures a fabric and scene.
        pool: number of different fabrics; sets share them, so that their simulations can be shared too.
        resolution_m: of the mesh; another one than the diagnosis uses.
        withhold: effects that the data has and the diagnosis's catalogue lacks.
        scenes: of every set.
    """

    cases: int
    seed: int
    fabrics: int = 4
    repeats: int = 2
    pool: int = 5
    resolution_m: float = 0.5 / 60
    withhold: tuple[str, ...] = ()
    scenes: tuple[str, ...] = ("hanging", "stretch")

    def check(self) -> None:
        """Refuse plans that cannot be.

        Raises:
            InputError: a number out of range, an unknown effect or none left, a scene twice, or cells that do not
                divide the sample.
        """
        for name in self.withhold:
            get_effect(name)
        for name in self.scenes:
            Scene.parse(name)
        if not self.scenes or len(set(self.scenes)) < len(self.scenes):
            raise InputError("give each scene once: hanging, stretch or both", code="blind_plan")
        if not visible_effects(self):
            raise InputError("every effect is withheld: leave some in the catalogue", code="no_effects")
        GridMesh(self.resolution_m)
        if self.cases < 1 or self.fabrics < 1 or self.repeats < 1 or self.pool < self.fabrics or self.seed < 0:
            raise InputError(
                "a blind check needs at least one case, one fabric, one repeat, a pool no smaller than a set's "
                "fabrics, and a seed of 0 or more",
                code="blind_plan",
            )
        if "withheld" in draw_kinds(self) and not unknown_effects(self):
            raise InputError(
                f"of {', '.join(self.withhold)} captures show nothing that the effects left in the catalogue do not: "
                "withhold another one, or all that are declared inseparable from it",
                code="blind_plan",
            )
        if "two" in draw_kinds(self) and len({group_of(e.name) for e in visible_effects(self)}) < 2:
            raise InputError(
                "sets with two effects need effects of two declared groups: withhold fewer", code="blind_plan"
            )


@dataclass(frozen=True)
class Label:
    """What is in a case.

    Attributes:
        kind: one of :data:`KINDS`.
        effects: switched on, with sizes.
        wrong: a parameter of the first fabric that is stated wrongly, and the factor by which the cloth's is larger.
    """

    kind: str
    effects: tuple[tuple[Effect, Size], ...] = ()
    wrong: tuple[str, float] | None = None

    def as_json(self, nonce: str) -> dict[str, Any]:
        """The sealed document; with the nonce its hash alone does not tell it (the check's seed would)."""
        return {
            "kind": self.kind,
            "effects": [
                {
                    "name": e.name,
                    "stage": e.stage.value,
                    "magnitude": _plain(e, size),
                    "unit": e.unit,
                    "place": {key: float(value) for key, value in size.items() if key not in e.components},
                }
                for e, size in self.effects
            ],
            "wrong_parameter": None if self.wrong is None else {"name": self.wrong[0], "factor": self.wrong[1]},
            "nonce": nonce,
        }


def visible_effects(plan: BlindPlan) -> list[Effect]:
    """What cases may have in them that the diagnosis knows and captures can show."""
    return [e for name, e in sorted(catalogue().items()) if name not in plan.withhold and _shows(e, plan)]


def hidden_effects(manifest: Mapping[str, Any]) -> list[str]:
    """Of a written check, effects of the catalogue that its captures cannot show, so that none has them."""
    withheld, scenes = tuple(manifest["withhold"]), tuple(manifest["scenes"])
    plan = BlindPlan(manifest["cases"], manifest["seed"], withhold=withheld, scenes=scenes)
    return [name for name, e in sorted(catalogue().items()) if name not in plan.withhold and not _shows(e, plan)]


def unknown_effects(plan: BlindPlan) -> tuple[str, ...]:
    """What cases may have in them that the diagnosis does not know: withheld, seen in captures, and with no declared
    twin left, whose name would be right.
    """
    return tuple(n for n in plan.withhold if group_of(n) <= {*plan.withhold} and _shows(get_effect(n), plan))


def _shows(effect: Effect, plan: BlindPlan) -> bool:
    scenes = [SimulationScene(Setup.nominal(scene)) for scene in plan.scenes]
    return effect.name not in INVISIBLE and any(effect.apply(scene, effect.typical()) != scene for scene in scenes)


def draw_kinds(plan: BlindPlan) -> list[str]:
    """Of all cases; any stretch of :data:`SHUFFLED` cases has the kinds in the same proportions."""
    deck = [kind for kind, count in SHUFFLED.items() for _ in range(count)]
    if not plan.withhold:
        deck = ["named" if kind == "withheld" else kind for kind in deck]
    rng = np.random.default_rng([plan.seed, 76])
    rounds = -(-plan.cases // len(deck))
    return [deck[int(k)] for _ in range(rounds) for k in rng.permutation(len(deck))][: plan.cases]


def draw_label(number: int, plan: BlindPlan) -> Label:
    """Of one case; the effects take turns, so that all come up."""
    rng = np.random.default_rng([plan.seed, number, 77])
    visible = visible_effects(plan)
    kinds = draw_kinds(plan)
    kind, turn = kinds[number], kinds[:number].count(kinds[number])
    if kind == "named":
        order = np.random.default_rng([plan.seed, 78]).permutation(len(visible))
        effect = visible[int(order[turn % len(visible)])]
        return Label(kind, ((effect, effect.draw(rng)),))
    if kind == "two":
        first, second = rng.choice(len(visible), size=2, replace=False)
        while visible[second].name in group_of(visible[first].name):  # declared inseparable: they count as one
            second = rng.choice(len(visible))
        return Label(kind, tuple((visible[k], visible[k].draw(rng)) for k in (int(first), int(second))))
    if kind == "withheld":
        unknown = unknown_effects(plan)
        effect = get_effect(unknown[turn % len(unknown)])
        return Label(kind, ((effect, effect.draw(rng)),))
    if kind == "wrong_parameter":
        return Label(kind, wrong=_draw_wrong(rng))
    return Label("none")


def _draw_wrong(rng: np.random.Generator) -> tuple[str, float]:
    """A parameter, and the factor by which the cloth's is larger than what is stated."""
    factor = float(np.exp(rng.uniform(np.log(1.8), np.log(3.0)))) ** (1 if rng.random() < 0.5 else -1)
    return ESTIMATED_NAMES[int(rng.integers(len(ESTIMATED_NAMES)))], factor


def simulable_wrong(
    wrong: tuple[str, float], synthesis: SynthesisPlan, stated: tuple[int, FabricParameters], seed: Sequence[int]
) -> tuple[str, float]:
    """What is wrong in a case, drawn again until there is such a cloth: one whose bias bends too easily beside its warp
    and weft is simulated stiffer than its label would say.

    Args:
        wrong: as drawn first.
        synthesis: how the case is made.
        stated: number and parameters of the fabric that has it.
        seed: of further draws.

    Raises:
        SimulationError: none of many draws makes such a cloth.
    """
    rng, (number, fabric) = np.random.default_rng(seed), stated
    for _ in range(MISSTATED_ATTEMPTS):
        real = real_fabric(replace(synthesis, wrong=wrong), number, fabric, first=True)
        if is_admissible(real.as_array()[None])[0]:
            return wrong
        wrong = _draw_wrong(rng)
    raise SimulationError(
        f"none of {MISSTATED_ATTEMPTS} fabrics with a parameter off by 1.8 to 3 is stable: choose another seed",
        code="fabric_not_stable",
    )


def make_blind_check(
    out: Path, plan: BlindPlan, *, cache: DrapeCache | None = None, on_case: Callable[[float], None] | None = None
) -> None:
    """Write the capture sets ``case-001`` ..., their sealed labels and the manifest; goes on where it was stopped.

    Raises:
        InputError: the plan cannot be, or ``out`` holds a check of another plan.
        SimulationError: a set cannot be simulated.
    """
    make = case_maker(out, plan, cache)
    for number in range(plan.cases):
        make(number)
        if on_case is not None:
            on_case(1.0)


def case_maker(out: Path, plan: BlindPlan, cache: DrapeCache | None = None) -> Callable[[int], None]:
    """Write the manifest; what is returned makes a case, by its number, if it is not there.

    Raises:
        InputError: the plan cannot be, or ``out`` holds a check of another plan or of another catalogue of effects.
    """
    plan.check()
    manifest = _manifest(plan)
    path = out / MANIFEST_FILE
    there = _read(path) if path.exists() else manifest
    if there != manifest:
        if isinstance(there, dict) and {**there, CATALOGUE: manifest[CATALOGUE]} == manifest:
            raise InputError(
                f"{out}: its cases were drawn from another catalogue of effects, or by an earlier version: put the "
                "effects' files back as they were, or make another check",
                code="blind_catalogue",
            )
        raise InputError(f"{out} holds a blind check of another plan: give another folder", code="blind_other_plan")
    (out / LABELS_FOLDER).mkdir(parents=True, exist_ok=True)
    write_atomically(path, (json.dumps(manifest, indent=1) + "\n").encode())
    fabrics = FabricPrior.default(DIAGNOSABLE).sample(range(plan.pool), plan.seed)
    shelf = cache or DrapeCache(out / "drapes")

    def make(number: int) -> None:
        if not is_sealed(out / case_name(number)):
            _make_case(out, case_name(number), number, plan, fabrics, shelf)

    return make


def _read(path: Path) -> Any:
    """What a manifest says; None where it cannot be read."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def is_sealed(folder: Path) -> bool:
    """A case is whole: its document, which is written last, holds the label's hash."""
    try:
        return "label_sha256" in json.loads((folder / CAPTURES_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError):
        return False


def case_name(number: int) -> str:
    """Folder of a case, numbered from 0."""
    return f"case-{number + 1:03d}"


def _make_case(
    out: Path, name: str, number: int, plan: BlindPlan, fabrics: Sequence[FabricParameters], cache: DrapeCache
) -> None:
    label = draw_label(number, plan)
    group = number // SHARED_BY
    chosen = np.random.default_rng([plan.seed, group, 80]).permutation(plan.pool)[: plan.fabrics]
    stated: Mapping[int, FabricParameters] = {int(k): fabrics[int(k)] for k in chosen}
    synthesis = SynthesisPlan(
        fabrics=plan.fabrics,
        scenes=plan.scenes,
        repeats=plan.repeats,
        resolution_m=plan.resolution_m,
        pin_radius_m=0.0,
        jitter=BLIND_JITTER,
        seed=1000 * plan.seed + group,
    )
    if label.wrong is not None:
        first = next(iter(stated.items()))
        label = replace(label, wrong=simulable_wrong(label.wrong, synthesis, first, [plan.seed, number, 81]))
        synthesis = replace(synthesis, wrong=label.wrong)
    truth = {
        f"f{place + 1}": real_fabric(synthesis, k, fabric, first=place == 0).as_dict()
        for place, (k, fabric) in enumerate(stated.items())
    }
    further = {}
    if label.effects:
        scene = "stretch" if "stretch" in plan.scenes else plan.scenes[0]
        more = replace(synthesis, scenes=(scene,), repeats=1, first_repeat=plan.repeats)
        folder = out / LABELS_FOLDER / name
        make_capture_set(folder, more, label.effects, fabrics=stated, name=name, cache=cache)
        files = [*sorted(folder.glob("*.png")), folder / CAPTURES_FILE]
        further = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    nonce = np.random.default_rng([plan.seed, number, 79]).bytes(16).hex()
    document = {**label.as_json(nonce), "parameters": truth, "further_captures_sha256": further}
    sealed = (json.dumps(document, indent=1) + "\n").encode()
    write_atomically(out / LABELS_FOLDER / f"{name}.json", sealed)
    made = make_capture_set(out / name, synthesis, label.effects, fabrics=stated, name=name, cache=cache)
    public = {**made.document.as_json(), "label_sha256": hashlib.sha256(sealed).hexdigest()}
    write_atomically(out / name / CAPTURES_FILE, (json.dumps(public, indent=1) + "\n").encode())


def plan_of(manifest: Mapping[str, Any]) -> BlindPlan:
    """The plan that a manifest was written from."""
    values = {key: value for key, value in manifest.items() if key in MANIFEST_KEYS}
    return BlindPlan(**{**values, "withhold": tuple(values["withhold"]), "scenes": tuple(values["scenes"])})


MANIFEST_KEYS = ("cases", "seed", "fabrics", "repeats", "pool", "resolution_m", "withhold", "scenes")
"""What a manifest says of its check beside the format and the catalogue's key."""
CATALOGUE = "catalogue_sha256"


def _manifest(plan: BlindPlan) -> dict[str, Any]:
    values = {name: getattr(plan, name) for name in MANIFEST_KEYS}
    values |= {"withhold": list(plan.withhold), "scenes": list(plan.scenes), CATALOGUE: catalogue_key()}
    return {"format": BLIND_FORMAT, **values}


def _plain(effect: Effect, size: Size) -> float | dict[str, float]:
    return float(size[SCALAR]) if SCALAR in size else {name: float(size[name]) for name in effect.components}
