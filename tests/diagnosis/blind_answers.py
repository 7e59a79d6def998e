"""Answers of a blind check that nobody diagnosed."""

from __future__ import annotations

from typing import Any

from diagnosis.blind.answers import Answer

CURL = {"name": "edge_curl", "stage": "fabric", "magnitude": 9.0, "unit": "1/m"}
TILT = {"name": "panel_tilt", "stage": "setup", "magnitude": 5.0, "unit": "degree"}
DRAFT = {"name": "air_draft", "stage": "environment", "magnitude": 0.33, "unit": "Pa"}
HEM = {"name": "hem_weight", "stage": "fabric", "magnitude": 20.0, "unit": "g/m"}
MANIFEST = {
    "cases": 6,
    "seed": 1,
    "scenes": ["stretch"],
    "fabrics": 4,
    "repeats": 2,
    "pool": 4,
    "resolution_m": 0.0125,
    "withhold": [],
}
"""Of a check with such answers."""


def answer(
    kind: str,
    truth: list[dict[str, Any]],
    top: str,
    p: float,
    *,
    rest: str = "none",
    also: str | None = None,
    detected: bool = True,
    closes: tuple[float, float] | None = (0.8, 0.1),
    verified: dict[str, Any] | None = None,
    **size: Any,
) -> Answer:
    """A case and what was said of it.

    Args:
        kind, truth: as the label has them.
        top, p: what was answered, and its probability.
        rest: what has all the other probability.
        also: a second effect that was named.
        detected: the gap was alarmed.
        closes: shrinkages of what was named and of the control; None where nothing could be held out.
        verified: what the further captures said.
        size: of what was named, where it is another one.
    """
    found = {"name": top, "magnitude": 0.3, "interval_90": [0.2, 0.4], **size}
    named = [] if top in ("none", "unknown") else [found, *([{"name": also}] if also else [])]
    shrinkage = {"fraction": closes[0], "control": {"fraction": closes[1]}} if named and closes else None
    report = {
        "gap": {"detected": detected, "p_value": 0.01},
        "cause": {"top": top, "probabilities": {rest: 1 - p, top: p}, "effects": named},
        "shrinkage": shrinkage,
        "verified": verified,
    }
    wrong = {"name": "bending_weft", "factor": 2.0} if kind == "wrong_parameter" else None
    label = {"kind": kind, "effects": truth, "wrong_parameter": wrong}
    names = {"nearest_template": "crease", "least_residual": "depth_scale", "most_flexible": "bending_hysteresis"}
    return Answer("case-001", label, report, {"names": names, "mmd_p": 0.5})


def further(
    share: float, true_share: float, covered: bool | None, errors: tuple[float, float, float] | None = None
) -> dict[str, Any]:
    """What further captures said of a case."""
    return {"fraction": share, "true_fraction": true_share, "covered": covered, "parameter_error": errors}
