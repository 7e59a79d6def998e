"""Grids and the user's own lists of fabrics."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from metric.library import load_library
from simcore.errors import InputError
from simcore.parameters import PARAMETER_NAMES
from simcore.prior import DEFAULT_RANGES, FabricPrior, is_admissible
from simcore.sampling_tables import grid_levels, log_grid, read_fabric_list

FABRICS = FabricPrior.default().sample(range(3))
HEADER = ",".join(PARAMETER_NAMES) + "\n"


def test_grid_is_full_even_and_inside_the_ranges() -> None:
    assert grid_levels(1) == (1,) * 7
    assert grid_levels(200) == (3, 2, 2, 2, 2, 2, 2)
    low, high = np.array([DEFAULT_RANGES[name] for name in PARAMETER_NAMES]).T
    grid = log_grid(DEFAULT_RANGES, 200)
    assert 100 < len(grid) <= 192
    assert ((grid > low) & (grid < high)).all() and is_admissible(grid).all()
    assert np.unique(grid[:, 0]).size == 3


def test_an_empty_grid_is_refused() -> None:
    for count in (0, -3):
        with pytest.raises(InputError, match=f"a grid of {count} fabrics: give at least 1") as caught:
            log_grid(DEFAULT_RANGES, count)
        assert caught.value.code == "grid_size"


def test_a_grid_without_a_plate_is_refused() -> None:
    ranges = {
        **DEFAULT_RANGES,
        "bending_warp": (1e-4, 2e-4),
        "bending_weft": (1e-6, 2e-6),
        "bending_bias": (1e-6, 2e-6),
    }
    with pytest.raises(InputError, match=r"no fabric of the grid .*: widen the ranges") as caught:
        log_grid(ranges, 200)
    assert caught.value.code == "ranges_empty"


def test_csv_and_json_lists_give_the_same_fabrics(tmp_path: Path) -> None:
    rows = [fabric.as_dict() for fabric in FABRICS]
    table = tmp_path / "fabrics.csv"
    lines = [",".join(["name", *PARAMETER_NAMES])]
    lines += [",".join(["x", *(repr(row[name]) for name in PARAMETER_NAMES)]) for row in rows]
    table.write_text("\n".join(lines))
    (tmp_path / "list.json").write_text(json.dumps(rows))
    capture_form = [{"id": "f", "density": r.pop("density"), "parameters": r} for r in map(dict, rows)]
    (tmp_path / "set.json").write_text(json.dumps({"fabrics": capture_form}))
    assert read_fabric_list(table) == FABRICS
    assert read_fabric_list(tmp_path / "list.json") == FABRICS
    assert read_fabric_list(tmp_path / "set.json") == FABRICS
    (tmp_path / "library.json").write_text(json.dumps({f"f{n}": row for n, row in enumerate(rows)}))
    assert read_fabric_list(tmp_path / "library.json") == FABRICS
    assert [fabric.parameters for fabric in load_library(tmp_path / "library.json")] == FABRICS


@pytest.mark.parametrize(
    ("name", "text", "message", "code"),
    [
        ("a.csv", "stretch_warp,density\n1,2\n", "no column is named stretch_weft, ", "parameter_missing"),
        (
            "a.csv",
            HEADER + "1,1,1,x,1e-5,1e-5,0.2\n",
            "fabric 1: bending_warp must be a number",
            "parameter_not_a_number",
        ),
        ("a.csv", HEADER + "1,1,1,1e-5,1e-5,1e-5,0,2\n", "row 1 has 8 cells where the header has 7", "csv_cells"),
        ("a.csv", HEADER + "1,1,1,1e-5,1e-5,1e-5,0,2\n", "a point, not a comma", "csv_cells"),
        ("a.csv", HEADER + "1,1,1,1e-5,1e-5,1e-5,0_2\n", "density must be a number", "parameter_not_a_number"),
        ("a.csv", "density," + HEADER + "1,1,1,1,1,1,1,2\n", "density occurs twice: leave one", "csv_column_twice"),
        ("a.csv", HEADER + '"1' + ",2\n" * 100_000, "close every quotation mark", "csv_form"),
        ("a.csv", HEADER + '"1', "close every quotation mark", "csv_form"),
        ("a.csv", HEADER.replace(",", ";") + "1;1;1;1e-5;1e-5;1e-5;0,2\n", "semicolons .*with commas", "csv_separator"),
        ("a.csv", HEADER.replace(",", "\t"), "tabs stand between .*with commas", "csv_separator"),
        ("a.csv", '"density";"stretch_warp"\n', "semicolons .*with commas", "csv_separator"),
        ("a.csv", HEADER.title(), "named stretch_warp, .*; the columns are Stretch_Warp, ", "parameter_missing"),
        ("a.csv", "", "holds no fabric", "list_empty"),
        ("a.csv", HEADER, "holds no fabric", "list_empty"),
        ("a.csv", HEADER + ",,,,,,\n , \n", "holds no fabric", "list_empty"),
        ("a.json", "[1, 2]", "a list of fabrics", "list_form"),
        ("a.json", "{", "not valid JSON", "file_not_json"),
        ("a.json", "[]", "holds no fabric", "list_empty"),
    ],
)
def test_bad_lists_name_the_place(tmp_path: Path, name: str, text: str, message: str, code: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_fabric_list(tmp_path / name)
    assert caught.value.code == code
    assert str(tmp_path / name) in str(caught.value)


def test_a_missing_list_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_fabric_list(tmp_path / "none.csv")
