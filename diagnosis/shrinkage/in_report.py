"""What a shrinkage says beside its millimetres: refitted parameters, and the same as people see it."""

from __future__ import annotations

from collections.abc import Mapping

from diagnosis.afresh.fresh import FreshLook
from diagnosis.report import RefittedParameters, Shrinkage
from diagnosis.shrinkage.held_out import Held, Measured
from diagnosis.shrinkage.seen_depth import seen_depth
from metric.weights import INSTEAD
from simcore.errors import InputError, MissingResourceError
from simcore.parameters import FabricParameters

NOT_AFRESH = "nothing was simulated afresh"


def complete(measured: Measured, looks: Mapping[str, FreshLook], *, lpips: bool) -> Shrinkage:
    """The shrinkage with refitted parameters or in depth, and in LPIPS where that is wanted and can be.

    Args:
        measured: the shrinkage and the blocks that were held out.
        looks: by fabric; empty: nothing can be simulated.
        lpips: measure LPIPS; a note says why where it cannot be.
    """
    from diagnosis.shrinkage.perception import perceived, refitted

    made = measured.shrinkage
    shown = measured.held or measured.seen
    if not looks or not shown:
        return made.model_copy(update={"note": f"not measured in LPIPS: {NOT_AFRESH}"}) if lpips else made
    parameters = tuple(
        RefittedParameters(
            fabric=one.block.fabric,
            before=_plain(refitted(looks[one.block.fabric], one.before)),
            after=_plain(refitted(looks[one.block.fabric], one.after)),
        )
        for one in _first_of_each(measured.held)
    )
    changes: dict[str, object] = {"parameters": parameters}
    if measured.seen:
        changes["depth"] = seen_depth(measured.seen, looks)
    if lpips:
        try:
            changes["perceived"] = perceived(shown, looks)
        except (MissingResourceError, InputError) as error:  # the latter: pictures too small for it
            why = str(error).removesuffix(f", {INSTEAD}")  # a diagnosis has no back ends to choose from
            changes["note"] = f"not measured in LPIPS: {why}"
    return made.model_copy(update=changes)


def _first_of_each(held: tuple[Held, ...]) -> list[Held]:
    first: dict[str, Held] = {}
    for one in held:
        first.setdefault(one.block.fabric, one)
    return list(first.values())


def _plain(fabric: FabricParameters) -> dict[str, float]:
    return {name: float(value) for name, value in fabric.as_dict().items()}
