"""Kernels whose loops run side by side, as on a GPU, compiled for the CPU in a process of their own."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

SCRIPT = """
import numpy as np
from simcore import lang
begin = lang.ti.init
lang.ti.init = lambda **how: begin(**{**how, "print_ir": True, "print_ir_dbg_info": False, "offline_cache": False})
lang.start()
lang.on_cpu = lambda: False
from simcore.mechanics import Mechanics, UniformCurvature
from tests.simcore.rigs import FABRICS, Rig, crumpled, strip
level = strip(0.08, 0.10, 0.02)
held = np.zeros((level.grid.rows, level.grid.columns), dtype=bool)
held[0] = True
bent = Mechanics(rest_curvature=(UniformCurvature(8.0, -3.0),), off_grain_rad=0.1, stiffening_strain=0.01)
rig = Rig.of(level, FABRICS["medium"], held, bent, panel=True)
x = crumpled(level.grid, 1)
assert abs(level.energy(x) / rig.cloth.energy(x) - 1.0) < 1e-12
assert abs(level.gradient(x) - rig.cloth.gradient(x)).max() < 1e-9
assert np.isfinite(rig.hessian(x)).all()
"""


def test_nothing_but_integers_passes_from_one_loop_to_the_next(repository: Path) -> None:
    # Taichi 1.7 packs what loops share behind 4-byte integers: a GPU does not read float64 there (misaligned address)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, cwd=str(repository), check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    shared = re.findall(r"<\*(.+?)> \$\d+ = global tmp var", done.stdout)
    assert len(shared) > 10, "Taichi prints its loops in another way"
    assert set(shared) == {"i32"}
