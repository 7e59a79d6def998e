"""Models of ``captures.json``, format ``drape-capture-set/1``: what the file may say, checked key by key.

Keys that the format does not name are kept as they are and written back by :meth:`CaptureSetDocument.as_json`, so that
other programs' additions survive. A key that was absent stays absent.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, WithJsonSchema, field_validator

from renderer.camera import Camera
from simcore.errors import InputError
from simcore.json_text import first_not_finite, parse_json, whole
from simcore.parameters import ESTIMATED_NAMES, LIMITS, UNITS

FORMAT: Final = "drape-capture-set/1"


# a text or a truth value is no number, though pydantic would take "0.2" and true for one
Number = Annotated[float, Field(strict=True)]
Vector3 = tuple[Number, Number, Number]
Row = tuple[Number, Number, Number, Number]
Pose = tuple[Row, Row, Row, Row]
Positive = Annotated[Number, Field(gt=0.0)]
NotNegative = Annotated[Number, Field(ge=0.0)]
Material = Annotated[Number, WithJsonSchema({"type": "number", "exclusiveMinimum": 0})]
"""A fabric's own number; :func:`_within_limits` looks at it, in words of its unit."""
Pixels = Annotated[int, Field(strict=True, ge=1, le=16384), BeforeValidator(whole)]
Truth = Annotated[bool, Field(strict=True)]
Name = Annotated[str, Field(min_length=1, max_length=200)]
PicturePath = Annotated[str, Field(min_length=1, max_length=4096)]
"""Beside ``captures.json``; as long as Linux takes."""


class _Model(BaseModel):
    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)


class CameraDocument(_Model):
    """Intrinsics in the OpenCV convention (see :class:`renderer.camera.Camera`)."""

    width: Pixels
    height: Pixels
    fx: Positive
    fy: Positive
    cx: Number
    cy: Number
    distortion: tuple[Number, Number, Number, Number, Number] | None = None
    depth_unit_m: Positive

    def as_camera(self) -> Camera:
        """The camera; no distortion where none is given."""
        return Camera(
            width=self.width,
            height=self.height,
            fx=self.fx,
            fy=self.fy,
            cx=self.cx,
            cy=self.cy,
            distortion=self.distortion or (0.0, 0.0, 0.0, 0.0, 0.0),
            depth_unit_m=self.depth_unit_m,
        )

    @classmethod
    def from_camera(cls, camera: Camera) -> CameraDocument:
        """The document of a camera."""
        return cls(
            width=camera.width,
            height=camera.height,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
            distortion=camera.distortion,
            depth_unit_m=camera.depth_unit_m,
        )


class SensorDocument(_Model):
    """The depth sensor as far as it is known."""

    range_noise_m: NotNegative | None = None
    at_m: Positive | None = None
    quantisation_m: NotNegative | None = None


class SetupDocument(_Model):
    """How the samples are put up, nominally; every key may be absent."""

    sample_size_m: tuple[Positive, Positive] | None = None
    camera_from_panel: Pose | None = None
    panel: Truth | None = None
    pins_m: dict[str, dict[str, Vector3]] | None = None
    pin_radius_m: NotNegative | None = None

    def overridden_by(self, other: SetupDocument | None) -> SetupDocument:
        """The keys of ``other`` over these; ``pins_m`` pin by pin. An explicit null counts."""
        if other is None:
            return self
        merged = {**self.model_dump(exclude_unset=True), **other.model_dump(exclude_unset=True)}
        if self.pins_m is not None and other.pins_m is not None:
            scenes = dict.fromkeys((*self.pins_m, *other.pins_m))
            merged["pins_m"] = {s: {**self.pins_m.get(s, {}), **other.pins_m.get(s, {})} for s in scenes}
        return SetupDocument.model_validate(merged)


class MechanicsDocument(_Model):
    """The six mechanical parameters of a fabric, where they are known."""

    stretch_warp: Material
    stretch_weft: Material
    stretch_bias: Material
    bending_warp: Material
    bending_weft: Material
    bending_bias: Material

    @field_validator(*ESTIMATED_NAMES)
    @classmethod
    def _within_limits(cls, value: float, info: Any) -> float:
        return _within_limits(info.field_name, value)


class FabricDocument(_Model):
    """One fabric of the set."""

    id: Name
    density: Material | None = None
    parameters: MechanicsDocument | None = None
    parameters_cv: NotNegative | None = None
    density_cv: NotNegative | None = None

    @field_validator("density")
    @classmethod
    def _density_within_limits(cls, value: float | None) -> float | None:
        return None if value is None else _within_limits("density", value)


class CaptureDocument(_Model):
    """One depth picture of one fabric in one scene."""

    id: Name
    fabric: Name
    scene: Literal["hanging", "stretch"]
    repeat: Annotated[int, Field(strict=True, ge=0), BeforeValidator(whole)] | None = None
    depth: PicturePath
    camera: CameraDocument | None = None
    setup: SetupDocument | None = None


class CaptureSetDocument(_Model):
    """The whole of ``captures.json``."""

    format: Literal["drape-capture-set/1"] = FORMAT
    name: str | None = None
    camera: CameraDocument
    sensor: SensorDocument | None = None
    setup: SetupDocument | None = None
    fabrics: Annotated[tuple[FabricDocument, ...], Field(min_length=1)]
    captures: Annotated[tuple[CaptureDocument, ...], Field(min_length=1)]

    def as_json(self) -> dict[str, Any]:
        """Plain JSON value with the keys that were given (and always ``format``)."""
        return {"format": self.format, **self.model_dump(mode="json", exclude_unset=True)}


def _within_limits(name: str, value: float) -> float:
    low, high = LIMITS[name]
    if not low <= value <= high:
        unit = UNITS[name]
        raise ValueError(f"{name} = {value:g} {unit} is outside {low:g} to {high:g} {unit}: give SI units")
    return value


def parse_document(text: str, source: str) -> CaptureSetDocument:
    """Check the text of a ``captures.json``.

    Args:
        text: what the file holds.
        source: its name, for messages.

    Raises:
        InputError: ``file_not_json``, ``capture_format_unknown``, ``capture_set_invalid``, ``scene_unknown``,
            ``number_not_finite``, ``parameter_out_of_range``, ``duplicate_id`` or ``fabric_unknown``; one line each.
    """
    value = parse_json(text, source)
    if not isinstance(value, dict):
        raise InputError(f"{source}: a JSON object in format {FORMAT!r} is needed", code="capture_set_invalid")
    if value.get("format") != FORMAT:
        stated = _shown(value.get("format"))
        raise InputError(
            f"{source}: format is {stated}, this version reads {FORMAT!r}: convert the set or write that format",
            code="capture_format_unknown",
        )
    try:
        place = first_not_finite(value)
    except RecursionError:
        raise InputError(f"{source}: not valid JSON (nested too deeply)", code="file_not_json") from None
    if place is not None:
        raise InputError(f"{source}: {place} is not a finite number", code="number_not_finite")
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise InputError(
            f"{source}: a text in it holds half a character (\\ud800 to \\udfff): write it whole",
            code="capture_set_invalid",
        ) from None
    try:
        document = CaptureSetDocument.model_validate(value)
    except ValidationError as error:
        raise _as_input_error(error, source) from None
    check_references(document, source)
    return document


def parse_camera(value: object, source: str) -> Camera:
    """Check a camera's plain value on its own.

    Raises:
        InputError: a value is missing or unusable.
    """
    if not isinstance(value, dict):
        raise InputError(
            f"{source}: a camera is an object with width, height, fx, fy, cx, cy and depth_unit_m",
            code="capture_set_invalid",
        )
    try:
        return CameraDocument.model_validate(value).as_camera()
    except ValidationError as error:
        raise _as_input_error(error, source) from None


def check_references(document: CaptureSetDocument, source: str) -> None:
    """Identifiers are unique and every capture's fabric is listed.

    Raises:
        InputError: ``duplicate_id`` or ``fabric_unknown``.
    """
    for what, names in (
        ("fabrics", [f.id for f in document.fabrics]),
        ("captures", [c.id for c in document.captures]),
    ):
        seen: set[str] = set()
        for name in names:
            if name in seen:
                raise InputError(f"{source}: two {what} have the id {name!r}: make ids unique", code="duplicate_id")
            seen.add(name)
    known = {fabric.id for fabric in document.fabrics}
    for capture in document.captures:
        if capture.fabric not in known:
            raise InputError(
                f"{source}: capture {capture.id!r} is of fabric {capture.fabric!r}, which fabrics does not list: "
                f"add it or choose one of {', '.join(sorted(known)[:8])}",
                code="fabric_unknown",
            )


NULL_TOO: Final = frozenset({"camera_from_panel", "density", "parameters"})
"""Keys that the format lets be null; :func:`parse_document` takes null for every key that may be absent."""


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of the format, made from these models: what it takes, the format takes."""
    schema = CaptureSetDocument.model_json_schema()
    schema["required"] = sorted({"format", *schema["required"]})
    for model in (schema, *schema["$defs"].values()):
        model["properties"] = {key: _said(key, said) for key, said in model["properties"].items()}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": FORMAT}


def _said(key: str, said: dict[str, Any]) -> dict[str, Any]:
    """What a schema says of a key: null only where the format has it."""
    if key in NULL_TOO or "anyOf" not in said:
        return said
    (other,) = (choice for choice in said["anyOf"] if choice != {"type": "null"})
    rest = {word: value for word, value in said.items() if word not in ("anyOf", "default")}
    return {**rest, **other}


_NEEDED: Final = {
    "float_type": "a number (without quotes)",
    "int_type": "a whole number (without quotes)",
    "bool_type": "true or false (without quotes)",
}


def _shown(value: object) -> str:
    """A value of the file, short, for a message."""
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "an object"
    return json.dumps(value)[:80]


def _as_input_error(error: ValidationError, source: str) -> InputError:
    """The first complaint of pydantic as one line of ours."""
    found = error.errors(include_url=False)
    first = found[0]
    place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"]).lstrip(".")
    message, code = first["msg"].removeprefix("Value error, "), "capture_set_invalid"
    if place.endswith(".scene") and first["type"] == "literal_error":
        message, code = f"unknown scene {first['input']!r}: choose hanging or stretch", "scene_unknown"
    elif first["type"] == "missing":
        message = "is missing"
    elif first["type"] in _NEEDED:
        message = f"{_shown(first['input'])} where {_NEEDED[first['type']]} is needed"
    elif first["type"] == "value_error":
        code = "parameter_out_of_range"
    # a list whose only entry was refused is called too short besides
    others = sum(
        other["type"] != "too_short" or other["loc"] != first["loc"][: len(other["loc"])] for other in found[1:]
    )
    more = f" (and {others} more)" if others else ""
    return InputError(f"{source}: {place}: {message}{more}", code=code)
