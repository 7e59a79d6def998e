"""The catalogue: every module in this folder that has an ``EFFECT`` is in it. Add a file to add an effect."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType, ModuleType

from diagnosis.effect import Effect
from simcore.errors import InputError


@cache
def catalogue() -> Mapping[str, Effect]:
    """All effects by name, in alphabetical order.

    Raises:
        InputError: a file cannot be imported or has no usable effect, or two give the same name.
    """
    found: dict[str, Effect] = {}
    for module in sorted(pkgutil.iter_modules(__path__), key=lambda m: m.name):
        effect = getattr(_load(module.name), "EFFECT", None)
        if not isinstance(effect, Effect):
            raise InputError(
                f"diagnosis/effects/{module.name}.py has no EFFECT: define EFFECT = Effect(...)", code="effect_file"
            )
        if effect.name in found:
            raise InputError(f"two files define the effect {effect.name!r}: rename one", code="effect_duplicate")
        found[effect.name] = effect
    return MappingProxyType(dict(sorted(found.items())))


def _load(name: str) -> ModuleType:
    """An effect's file; whatever is wrong with it is said of it, since users add their own."""
    try:
        return importlib.import_module(f"{__name__}.{name}")
    except Exception as error:
        said = " ".join(str(error).split()) or "no reason given"
        raise InputError(
            f"diagnosis/effects/{name}.py cannot be used: {type(error).__name__}: {said}", code="effect_file"
        ) from error


def get_effect(name: str) -> Effect:
    """An effect by name.

    Raises:
        InputError: no such effect; the message lists the names.
    """
    effects = catalogue()
    if name not in effects:
        raise InputError(f"unknown effect {name!r}: choose from {', '.join(effects)}", code="effect_unknown")
    return effects[name]


def parse_effect(text: str) -> tuple[Effect, dict[str, float]]:
    """``NAME=MAGNITUDE`` or ``NAME=component:value,component:value`` from a command line.

    Raises:
        InputError: another form, an unknown effect or component, or not a number.
    """
    name, separator, value = text.partition("=")
    effect = get_effect(name.strip())
    if not separator or not value.strip():
        raise InputError(
            f"{text!r}: give the magnitude too, {effect.name}=NUMBER [{effect.unit}]"
            + (f" or {effect.name}=" + ",".join(f"{c}:NUMBER" for c in effect.components) if effect.vector else ""),
            code="effect_magnitude",
        )
    try:
        if ":" not in value:
            return effect, effect.size(float(value))
        if nameless := [part for part in value.split(",") if ":" not in part]:
            form = ",".join(f"{known}:NUMBER" for known in (*effect.components, *effect.places[0]))
            raise InputError(
                f"{text!r}: {nameless[0]!r} has no name: write {effect.name}={form}, as many of them as you give",
                code="effect_magnitude",
            )
        pairs = [(part.partition(":")[0].strip(), float(part.partition(":")[2])) for part in value.split(",")]
    except ValueError:
        raise InputError(f"{text!r}: {value!r} is not a number", code="effect_magnitude") from None
    if len(dict(pairs)) < len(pairs):
        raise InputError(f"{text!r}: a component is given twice: give it once", code="effect_magnitude")
    return effect, effect.size(dict(pairs))
