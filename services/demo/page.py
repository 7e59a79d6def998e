"""The page that shows what the demonstration made."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path

from renderer.atomic import write_atomically
from services.demo.chain import DemoResult
from services.demo.plan import DemoPlan
from simcore.parameters import UNITS


def write_page(out: Path, result: DemoResult, plan: DemoPlan) -> Path:
    """Write ``index.html`` beside the pictures and return its path."""
    from jinja2 import Environment, StrictUndefined

    text = resources.files("services.demo").joinpath("templates/index.html.j2").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    page = environment.from_string(text).render(
        result=result,
        plan=plan,
        units=UNITS,
        factor=math.exp(result.error),
        factor_of_mean=math.exp(result.error_of_mean),
        minutes=sum(result.seconds.values()) / 60.0,
    )
    path = out / "index.html"
    write_atomically(path, page.encode())
    return path
