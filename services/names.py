"""Names as people write them: lists of them with commas, and what is none."""

from __future__ import annotations


def split_names(text: str) -> tuple[str, ...]:
    """The names of a comma-separated list, without spaces round them; what is empty is no name."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def is_text(name: str) -> bool:
    """Whether a name is of characters: a shell may hand over bytes that are none, which no database takes."""
    return not any("\ud800" <= character <= "\udfff" for character in name)
