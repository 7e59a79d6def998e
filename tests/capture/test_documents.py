"""captures.json: what is read is what is written, extra keys included; what is wrong is named."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture.documents import FORMAT, CameraDocument, SetupDocument, json_schema, parse_document
from simcore.errors import InputError
from simcore.parameters import ESTIMATED_NAMES, LIMITS

# Libraries compiled for speed, once loaded, have the processor flush subnormal numbers to zero.
finite = st.floats(-1e3, 1e3, allow_nan=False, allow_subnormal=False)
positive = st.floats(1e-3, 1e3)
names = st.text(
    st.characters(codec="utf-8", exclude_characters="\0", exclude_categories=("Cs",)), min_size=1, max_size=12
)
extra_values = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | finite | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=2),
    max_leaves=4,
)


def with_extras(base: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[dict[str, Any]]:
    extras = st.dictionaries(st.text("xyz_", min_size=3, max_size=6), extra_values, max_size=2)
    return st.tuples(extras, base).map(lambda pair: {**pair[0], **pair[1]})


cameras = with_extras(
    st.fixed_dictionaries(
        {
            "width": st.integers(1, 4000),
            "height": st.integers(1, 4000),
            "fx": positive,
            "fy": positive,
            "cx": finite,
            "cy": finite,
            "depth_unit_m": st.sampled_from([1e-4, 1e-3, 2.5e-4]),
        },
        optional={"distortion": st.lists(finite, min_size=5, max_size=5)},
    )
)
scenes = st.sampled_from(["hanging", "stretch"])
places = st.lists(finite, min_size=3, max_size=3)
setups = with_extras(
    st.fixed_dictionaries(
        {},
        optional={
            "sample_size_m": st.lists(positive, min_size=2, max_size=2),
            "camera_from_panel": st.none() | st.lists(st.lists(finite, min_size=4, max_size=4), min_size=4, max_size=4),
            "panel": st.booleans(),
            "pin_radius_m": st.floats(0, 1, allow_subnormal=False),
            "pins_m": st.dictionaries(
                st.sampled_from(["hanging", "stretch"]), st.dictionaries(names, places, max_size=2)
            ),
        },
    )
)
parameters = st.fixed_dictionaries({name: st.floats(*LIMITS[name]) for name in ESTIMATED_NAMES})
fabric_rests = with_extras(
    st.fixed_dictionaries(
        {},
        optional={
            "density": st.none() | st.floats(*LIMITS["density"]),
            "parameters": st.none() | parameters,
            "parameters_cv": st.floats(0, 1, allow_subnormal=False),
            "density_cv": st.floats(0, 1, allow_subnormal=False),
        },
    )
)


@st.composite
def documents(draw: st.DrawFn) -> dict[str, Any]:
    fabric_ids = draw(st.lists(names, min_size=1, max_size=3, unique=True))
    capture_ids = draw(st.lists(names, min_size=1, max_size=3, unique=True))
    captures = []
    for name in capture_ids:
        base = {
            "id": name,
            "fabric": draw(st.sampled_from(fabric_ids)),
            "scene": draw(st.sampled_from(["hanging", "stretch"])),
            "depth": draw(names),
        }
        optional = st.fixed_dictionaries({}, optional={"repeat": st.integers(0, 9), "camera": cameras, "setup": setups})
        captures.append({**base, **draw(optional)})
    document = {
        "format": FORMAT,
        "camera": draw(cameras),
        "fabrics": [{"id": name, **draw(fabric_rests)} for name in fabric_ids],
        "captures": captures,
    }
    optional = st.fixed_dictionaries({}, optional={"name": st.text(max_size=9), "setup": setups})
    return {**draw(with_extras(optional)), **document}


@given(documents())
@settings(max_examples=60, deadline=None)
def test_a_document_is_written_back_as_it_was_read(document: dict[str, Any]) -> None:
    read = parse_document(json.dumps(document), "captures.json")
    assert read.as_json() == document
    assert parse_document(json.dumps(read.as_json()), "captures.json") == read
    jsonschema.validate(document, json_schema())


@given(documents())
@settings(max_examples=20, deadline=None)
def test_what_we_take_is_what_the_contract_takes(shared_dir: Path, document: dict[str, Any]) -> None:
    schema = json.loads((shared_dir / "contracts" / "capture-set.schema.json").read_text())
    jsonschema.validate(parse_document(json.dumps(document), "captures.json").as_json(), schema)


def test_the_schema_made_from_the_models_is_a_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(json_schema())


def good() -> dict[str, Any]:
    return {
        "format": FORMAT,
        "camera": {"width": 4, "height": 3, "fx": 4.0, "fy": 4.0, "cx": 1.5, "cy": 1.0, "depth_unit_m": 1e-4},
        "fabrics": [{"id": "a"}],
        "captures": [{"id": "a-0", "fabric": "a", "scene": "hanging", "depth": "a.png"}],
    }


def put(path: str, value: Any) -> dict[str, Any]:
    document: Any = good()
    *way, last = path.split("/")
    place = document
    for step in way:
        place = place[int(step) if step.isdigit() else step]
    place[int(last) if last.isdigit() else last] = value
    return document


SIX = {name: LIMITS[name][0] * 10 for name in ESTIMATED_NAMES}


@pytest.mark.parametrize(
    ("document", "code", "said"),
    [
        ([], "capture_set_invalid", "JSON object"),
        ({}, "capture_format_unknown", "format is null"),
        (put("format", "drape-capture-set/9"), "capture_format_unknown", "drape-capture-set/1"),
        (put("captures", []), "capture_set_invalid", "captures"),
        (put("captures/0/scene", "draping"), "scene_unknown", "hanging or stretch"),
        (put("captures/0/fabric", "b"), "fabric_unknown", "choose one of a"),
        (put("captures", good()["captures"] * 2), "duplicate_id", "'a-0'"),
        (put("fabrics", [{"id": "a"}, {"id": "a"}]), "duplicate_id", "'a'"),
        (put("camera/fx", -1.0), "capture_set_invalid", "camera.fx"),
        (put("camera/fx", float("nan")), "number_not_finite", "camera.fx"),
        (put("camera", {"width": 4}), "capture_set_invalid", "is missing"),
        (put("camera/distortion", [0.0] * 4), "capture_set_invalid", "camera.distortion"),
        (put("fabrics/0/density", -0.2), "parameter_out_of_range", "density"),
        (put("fabrics/0/density", 200.0), "parameter_out_of_range", "kg/m²"),
        (put("fabrics/0/density", float("inf")), "number_not_finite", "fabrics[0].density"),
        (put("fabrics/0/density", "heavy"), "capture_set_invalid", "fabrics[0].density"),
        (put("fabrics/0/density", "0.2"), "capture_set_invalid", 'density: "0.2" where a number (without quotes)'),
        (put("fabrics/0/density", True), "capture_set_invalid", "density: true where a number"),
        (put("fabrics/0/density", [0.2]), "capture_set_invalid", "density: a list where a number"),
        (put("camera/width", "4"), "capture_set_invalid", "camera.width"),
        (put("camera/width", 4.5), "capture_set_invalid", "camera.width: 4.5 where a whole number"),
        (put("camera/fx", 10**400), "capture_set_invalid", "camera.fx"),
        (put("captures/0/repeat", "0"), "capture_set_invalid", "captures[0].repeat"),
        (put("setup", {"panel": "yes"}), "capture_set_invalid", "setup.panel"),
        (put("setup", {"sample_size_m": ["0.5", 0.5]}), "capture_set_invalid", "setup.sample_size_m[0]"),
        (put("fabrics/0/parameters", {**SIX, "bending_warp": -1e-5}), "parameter_out_of_range", "bending_warp"),
        (put("fabrics/0/parameters", {**SIX, "stretch_warp": 1e9}), "parameter_out_of_range", "stretch_warp"),
        (put("fabrics/0/parameters", {"stretch_warp": 100.0}), "capture_set_invalid", "is missing"),
        (put("extra", [1.0, float("nan")]), "number_not_finite", "extra[1]"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(document: Any, code: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_document(json.dumps(document), "captures.json")
    assert caught.value.code == code
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_whole_numbers_may_have_a_point_and_others_may_lack_one() -> None:
    document = put("camera/width", 4.0)
    document["camera"]["fx"] = 4
    document["captures"][0]["repeat"] = 1.0
    read = parse_document(json.dumps(document), "captures.json")
    assert (read.camera.width, read.camera.fx, read.captures[0].repeat) == (4, 4.0, 1)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, '{"format": '])
def test_what_is_not_json_is_said_so(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_document(text, "captures.json")
    assert caught.value.code == "file_not_json"


def test_a_captures_setup_goes_over_the_sets_key_by_key() -> None:
    base = SetupDocument.model_validate(
        {"panel": True, "pin_radius_m": 0.02, "pins_m": {"hanging": {"top_left": [0, 0, 0]}}, "note": "kept"}
    )
    own = SetupDocument.model_validate({"panel": False, "pins_m": {"stretch": {"top_left": [1, 0, 0]}}})
    merged = base.overridden_by(own)
    assert merged.panel is False
    assert merged.pin_radius_m == 0.02
    assert set(merged.pins_m or {}) == {"hanging", "stretch"}
    assert (merged.model_extra or {})["note"] == "kept"
    assert base.overridden_by(None) is base
    other = SetupDocument.model_validate({"pins_m": {"hanging": {"top_right": [1, 0, 0]}}})
    assert set((base.overridden_by(other).pins_m or {})["hanging"]) == {"top_left", "top_right"}


def test_a_camera_without_distortion_has_none() -> None:
    assert CameraDocument.model_validate(good()["camera"]).as_camera().distortion == (0.0,) * 5


def test_an_empty_object_of_pins_leaves_the_sets() -> None:
    pins = {"hanging": {"top_left": (-0.19, 0.0, 0.0)}}
    common = SetupDocument.model_validate({"pins_m": pins})
    for own in ({"pins_m": {}}, {"pins_m": {"hanging": {}}}):
        assert common.overridden_by(SetupDocument.model_validate(own)).pins_m == common.pins_m
    assert common.overridden_by(SetupDocument.model_validate({"pins_m": None})).pins_m is None


def whole() -> dict[str, Any]:
    """A document with every key that the format names."""
    setup = {
        "sample_size_m": [0.5, 0.5],
        "camera_from_panel": [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]],
        "panel": True,
        "pins_m": {"hanging": {"top_left": [-0.2, 0, 0]}},
        "pin_radius_m": 0.01,
    }
    camera = {**good()["camera"], "distortion": [0.0] * 5}
    fabric = {"id": "a", "density": 0.2, "parameters": SIX, "parameters_cv": 0.07, "density_cv": 0.02}
    capture = {**good()["captures"][0], "repeat": 0, "camera": camera, "setup": setup}
    sensor = {"range_noise_m": 0.001, "at_m": 0.9, "quantisation_m": 0.0002}
    top = {"name": "all", "camera": camera, "sensor": sensor, "setup": setup}
    return {"format": FORMAT, **top, "fabrics": [fabric], "captures": [capture]}


def spoilt(value: Any) -> Iterator[Any]:
    """A value with each of its parts in turn left out, or something else in its place."""
    for key, part in value.items() if isinstance(value, dict) else enumerate(value):
        inner = spoilt(part) if isinstance(part, dict | list) else ()
        for other in (None, -1, 0, 0.5, 1, "", "x", True, [], {}, *inner):
            changed = copy.copy(value)
            changed[key] = other
            yield changed
        changed = copy.copy(value)
        del changed[key]
        yield changed


def test_what_the_printed_schema_takes_is_what_the_contract_takes(shared_dir: Path) -> None:
    contract = jsonschema.Draft202012Validator(
        json.loads((shared_dir / "contracts" / "capture-set.schema.json").read_text())
    )
    printed = jsonschema.Draft202012Validator(json_schema())
    taken = [document for document in (whole(), *spoilt(whole())) if printed.is_valid(document)]
    assert whole() in taken and len(taken) > 20
    refused = {f"{list(error.path)}: {error.message}" for document in taken for error in contract.iter_errors(document)}
    assert refused == set()


@pytest.mark.parametrize(
    ("key", "value", "taken"),
    [
        ("fabrics/0/density", 0, False),
        ("fabrics/0/density", None, True),
        ("fabrics/0/parameters", {**SIX, "bending_warp": 0}, False),
        ("fabrics/0/parameters", None, True),
        ("fabrics/0/parameters_cv", None, False),
        ("captures/0/repeat", None, False),
        ("captures/0/camera", None, False),
        ("setup", {"camera_from_panel": None}, True),
        ("setup", {"panel": None}, False),
        ("sensor", None, False),
        ("name", None, False),
    ],
)
def test_the_printed_schema_takes_null_where_the_format_has_it_and_no_fabric_of_nothing(
    key: str, value: Any, taken: bool
) -> None:
    assert jsonschema.Draft202012Validator(json_schema()).is_valid(put(key, value)) is taken
