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


def test_grid_is_full_even_and_inside_the_ranges() -> None:
    assert grid_levels(1) == (1,) * 7
    assert grid_levels(200) == (3, 2, 2, 2, 2, 2, 2)
    low, high = np.array([DEFAULT_RANGES[name] for name in PARAMETER_NAMES]).T
    grid = log_grid(DEFAULT_RANGES, 200)
    assert 100 < len(grid) <= 192
    assert ((grid > low) & (grid < high)).all() and is_admissible(grid).all()
    assert np.unique(grid[:, 0]).size == 3


def test_an_empty_grid_is_refused() -> None:
    with pytest.raises(InputError):
        grid_levels(0)


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
    ("name", "text", "message"),
    [
        ("a.csv", "stretch_warp,density\n1,2\n", "fabric 1: fabric parameters lack"),
        (
            "a.csv",
            ",".join(PARAMETER_NAMES) + "\n" + "1,1,1,x,1e-5,1e-5,0.2\n",
            "fabric 1: bending_warp must be a number",
        ),
        ("a.csv", ",".join(PARAMETER_NAMES) + "\n" + "1,1,1,1e-5,1e-5,1e-5,0,2\n", "a point, not a comma"),
        ("a.csv", ",".join(PARAMETER_NAMES) + "\n" + "1,1,1,1e-5,1e-5,1e-5,0_2\n", "density must be a number"),
        ("a.csv", ",".join([*PARAMETER_NAMES, "density"]) + "\n1,1,1,1,1,1,1,2\n", "density occurs twice"),
        ("a.csv", ",".join(PARAMETER_NAMES) + '\n"1' + ",2\n" * 100_000, "close every quotation mark"),
        ("a.csv", "", "holds no fabric"),
        ("a.json", "[1, 2]", "a list of fabrics"),
        ("a.json", "{", "not valid JSON"),
        ("a.json", "[]", "holds no fabric"),
    ],
)
def test_bad_lists_name_the_place(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read_fabric_list(tmp_path / name)


def test_a_missing_list_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_fabric_list(tmp_path / "none.csv")
