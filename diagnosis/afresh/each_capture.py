"""Every capture of one scene looked at again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from diagnosis.afresh.fresh import FreshLook
from diagnosis.tasks.fabric_task import CaptureResult


def each_capture(look: FreshLook, change: Callable[[FreshLook, CaptureResult], CaptureResult], scene: str) -> FreshLook:
    """A fabric with its captures of a scene changed; those of another one as they were.

    Args:
        look: of the fabric; ``change`` may let it learn.
        change: a capture as it is now known; to work in another process it must be picklable.
        scene: whose captures are looked at.
    """
    captures = [change(look, c) if c.scene == scene else c for c in look.result.captures]
    return replace(look, result=replace(look.result, captures=tuple(captures)))
