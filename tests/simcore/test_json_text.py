"""JSON of somebody else: what is refused, however long it is."""

from __future__ import annotations

import json

import pytest

from simcore.errors import InputError
from simcore.json_text import parse_json


def test_a_key_twice_among_very_many_is_found_in_one_pass() -> None:
    """Looked for anew at each key, half a million of them would take the best part of an hour."""
    keys = [str(number) for number in range(500_000)]
    text = "{" + ", ".join(f"{json.dumps(key)}: 0" for key in [*keys, keys[-2], keys[-1]]) + "}"
    with pytest.raises(InputError, match=r"s\.json: '499998' is given twice in one object: give it once") as caught:
        parse_json(text, "s.json")
    assert caught.value.code == "file_key_twice"
