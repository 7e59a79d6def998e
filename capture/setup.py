"""From the ``setup`` of a capture set to the set-up of a scene."""

from __future__ import annotations

from capture.documents import SetupDocument
from simcore.errors import InputError
from simcore.scenes import PIN_NAMES, Scene, Setup

DEFAULT_SAMPLE_SIZE_M = (0.5, 0.5)
DEFAULT_PIN_RADIUS_M = 0.01
ON_PANEL_M = 1e-3
"""So far behind the panel a pin's place is an error of measuring or rounding: a magnet sits on it."""


def pin_source(scene: Scene, document: SetupDocument) -> str:
    """Where the pins come from: ``given`` (``pins_m``), ``pin_distance`` (``pin_distance_m``) or ``nominal``."""
    if document.pins_m and scene.value in document.pins_m:
        return "given"
    if scene is Scene.HANGING and _pin_distance_m(document) is not None:
        return "pin_distance"
    return "nominal"


def setup_from_document(scene: Scene, document: SetupDocument) -> Setup:
    """The set-up of one scene; what the document leaves open is nominal.

    Defaults: a sample of 0.5 x 0.5 m, a pin radius of 0.01 m, a panel, the design's pins scaled to the sample's size.
    An extra key ``pin_distance_m`` places the two pins of ``hanging`` that far apart. Pins that the scene does not have
    are passed over; one that is measured a hair behind the panel (:data:`ON_PANEL_M`) is on it.

    Raises:
        InputError: the set-up cannot be (see :class:`simcore.scenes.Setup`), or a pin of the scene is missing.
    """
    nominal = Setup.nominal(
        scene,
        sample_size_m=document.sample_size_m or DEFAULT_SAMPLE_SIZE_M,
        pin_radius_m=DEFAULT_PIN_RADIUS_M if document.pin_radius_m is None else document.pin_radius_m,
        panel=True if document.panel is None else document.panel,
    )
    source = pin_source(scene, document)
    if source == "nominal":
        return nominal
    if source == "pin_distance":
        half = 0.5 * (_pin_distance_m(document) or 0.0)
        return nominal.with_pins(top_left=(-half, 0.0, 0.0), top_right=(half, 0.0, 0.0))
    stated = (document.pins_m or {})[scene.value]
    given = {name: place for name, place in stated.items() if name in PIN_NAMES[scene]}
    if nominal.panel:
        given = {name: (x, y, 0.0 if -ON_PANEL_M <= z < 0.0 else z) for name, (x, y, z) in given.items()}
    return Setup(scene, nominal.sample_size_m, given, nominal.pin_radius_m, nominal.panel)


def passed_over(scene: Scene, document: SetupDocument) -> list[str]:
    """Names of pins that a document states for a scene that has none of that name."""
    return [name for name in (document.pins_m or {}).get(scene.value, {}) if name not in PIN_NAMES[scene]]


def _pin_distance_m(document: SetupDocument) -> float | None:
    value = (document.model_extra or {}).get("pin_distance_m")
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value <= 5.0:
        raise InputError(f"pin_distance_m is {value!r}: give a distance in metres", code="pin_distance")
    return float(value)
