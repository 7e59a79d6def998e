"""Lists of names as people write them: with commas."""

from __future__ import annotations


def split_names(text: str) -> tuple[str, ...]:
    """The names of a comma-separated list, without spaces round them; what is empty is no name."""
    return tuple(name.strip() for name in text.split(",") if name.strip())
