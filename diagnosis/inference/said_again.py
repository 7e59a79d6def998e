"""Whether what speaks for something unknown only says again what effects of the catalogue say."""

from __future__ import annotations

SAID, UNSAID = 0.5, 0.35
"""One effect, or two, that gain more than this share of what something unknown gains, and leave less than this,
explain it."""


def is_said_again(alone: float, left: float, gained: float) -> bool:
    """Whether effects explain what speaks for something unknown.

    Args:
        alone: what something unknown gains without them.
        left: the same beside them.
        gained: by them [all in nats, against nothing].
    """
    return alone > 0.0 and gained > SAID * alone and left < UNSAID * alone
