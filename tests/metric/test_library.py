"""Libraries of fabrics from JSON and CSV."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from metric.library import load_library
from simcore.errors import InputError
from simcore.parameters import PARAMETER_NAMES

VALUES = dict(zip(PARAMETER_NAMES, (300.0, 250.0, 80.0, 2e-5, 1e-5, 1.5e-5, 0.2), strict=True))


@pytest.mark.parametrize(
    "document",
    [
        [{"id": "a", **VALUES}, {"id": "b", **VALUES, "density": 0.3}],
        {"fabrics": [{"id": "a", **VALUES}, {"id": "b", **VALUES, "density": 0.3}]},
        {"a": VALUES, "b": {**VALUES, "density": 0.3}},
        [{"id": "a", "parameters": VALUES}, {"id": "b", "parameters": VALUES, "density": 0.3}],
    ],
)
def test_json_forms(document: object, tmp_path: Path) -> None:
    path = tmp_path / "library.json"
    path.write_text(json.dumps(document))
    library = load_library(path)
    assert [f.id for f in library] == ["a", "b"]
    assert library[0].parameters.as_dict() == VALUES


def test_csv(tmp_path: Path) -> None:
    path = tmp_path / "library.csv"
    names = ("id", *PARAMETER_NAMES, "note")
    row = ",".join(str(VALUES[n]) for n in PARAMETER_NAMES)
    empty = "," * (len(names) - 1)
    path.write_text("\n".join([empty, ",".join(names), f"x,{row},soft", empty, f"y,{row},", " ,,", empty]))
    fabric, other = load_library(path)
    assert (fabric.id, other.id) == ("x", "y")
    assert fabric.parameters.bending_weft == VALUES["bending_weft"]


@pytest.mark.parametrize(
    ("header", "told", "code"),
    [
        (
            f"ID,{','.join(PARAMETER_NAMES)}",
            "no column is named id; the columns are ID, stretch_warp,",
            "library_id_missing",
        ),
        (
            f"id,{','.join(PARAMETER_NAMES[:6])},mass",
            "no column is named density; .*bending_bias, mass:",
            "parameter_missing",
        ),
        (f"id;{';'.join(PARAMETER_NAMES)}", "separate columns with commas", "csv_separator"),
    ],
)
def test_a_header_that_is_none_is_told_not_its_fabrics(header: str, told: str, code: str, tmp_path: Path) -> None:
    path = tmp_path / "library.csv"
    mark = ";" if ";" in header else ","
    path.write_text(f"{header}\n" + mark.join(["x", *(str(VALUES[n]) for n in PARAMETER_NAMES)]))
    with pytest.raises(InputError, match=told) as caught:
        load_library(path)
    assert caught.value.code == code


@pytest.mark.parametrize("nested", [False, True])
def test_a_fabric_has_the_id_that_it_stands_under_and_no_other(nested: bool, tmp_path: Path) -> None:
    path = tmp_path / "library.json"

    def stating(own: object) -> dict[str, object]:
        return {"parameters": {**VALUES, "id": own}} if nested else {**VALUES, "id": own}

    path.write_text(json.dumps({"fabrics": {"a": VALUES, "b": stating("zz")}}))
    with pytest.raises(InputError, match="the fabric under 'b' has the id 'zz': leave its id out") as caught:
        load_library(path)
    assert caught.value.code == "library_id_differs" and str(path) in str(caught.value)
    path.write_text(json.dumps({"a": stating("a"), "7": stating(7), "c": stating(None)}))
    assert [fabric.id for fabric in load_library(path)] == ["a", "7", "c"]


@pytest.mark.parametrize(
    ("name", "text", "code"),
    [
        ("l.json", "[]", "library_empty"),
        ("l.json", "{", "file_not_json"),
        ("l.json", '"x"', "list_form"),
        ("l.json", json.dumps([VALUES]), "library_id_missing"),
        ("l.json", json.dumps([{"id": "a", **VALUES}] * 2), "library_id_twice"),
        ("l.json", json.dumps([{"id": "a\ud800", **VALUES}]), "library_id"),
        ("l.json", f'{{"a": {json.dumps(VALUES)}, "a": {json.dumps(VALUES)}}}', "file_key_twice"),
        ("l.json", json.dumps([{"id": "a", **VALUES, "density": -1}]), "parameter_out_of_range"),
        ("l.json", json.dumps([{"id": "a", "density": 0.2}]), "parameter_missing"),
        ("l.csv", "id,density\na,0.2\n", "parameter_missing"),
        ("l.csv", f"id,{','.join(PARAMETER_NAMES)}\na,300,250,80,2e-5,1e-5,1e-5,heavy\n", "parameter_not_a_number"),
    ],
)
def test_unusable_libraries(name: str, text: str, code: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_library(path)
    assert caught.value.code == code
    assert str(path) in str(caught.value)


def test_no_such_library(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_library(tmp_path / "none.json")
