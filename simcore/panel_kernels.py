"""Taichi functions of what the panel does to one vertex: barrier, adhesion, friction, and springs to a given height.

Barrier: -s (t - 1)² ln t, t = z / reach, of incremental potential contact (Li et al. 2020, eq. 6).
Adhesion: -c p A r (1 - t²)², t = z / r: a pull that rises to the pressure p and is gone at the range r.
Friction: mu N (sqrt(|d|² + slip²) - slip), d the shift in the panel's plane from the anchor, N the lagged normal force.
Spring: ½ k (z - height)².
"""

from simcore.lang import ti
from simcore.membrane_kernels import ADHESION_RANGE, PANEL, mat3, vec3

REACH_M = 1e-3
"""Distance from the panel at which it begins to push [m]."""
SLIP_M = 5e-4
"""Displacement over which friction builds up [m]."""
BEHIND = 1e300
"""Energy of a vertex at or behind the panel [J]: stands for infinity."""

BARRIER, ADHESION, FRICTION, ANCHOR_X, ANCHOR_Y, SPRING, HEIGHT = range(7)
NUMBERS = 7
"""Numbers of a vertex: s [J], c p A [N], mu N [N], anchor [m], k [N/m], height [m]."""


@ti.func
def panel_energy(here, panel: ti.template(), s, b, j, i):
    """[J]"""
    away = here[2] - panel[b, j, i, HEIGHT]
    energy = 0.5 * panel[b, j, i, SPRING] * away * away
    if s[PANEL] > 0.0:
        z = here[2]
        if z <= 0.0:
            energy += BEHIND
        elif z < REACH_M:
            t = z / REACH_M
            energy -= panel[b, j, i, BARRIER] * (t - 1.0) ** 2 * ti.log(t)
        if panel[b, j, i, ADHESION] > 0.0 and z < s[ADHESION_RANGE]:
            t = z / s[ADHESION_RANGE]
            energy -= panel[b, j, i, ADHESION] * s[ADHESION_RANGE] * (1.0 - t * t) ** 2
        if panel[b, j, i, FRICTION] > 0.0:
            dx, dy = here[0] - panel[b, j, i, ANCHOR_X], here[1] - panel[b, j, i, ANCHOR_Y]
            energy += panel[b, j, i, FRICTION] * (ti.sqrt(dx * dx + dy * dy + SLIP_M * SLIP_M) - SLIP_M)
    return energy


@ti.func
def panel_slope(here, panel: ti.template(), s, b, j, i):
    """Derivative [N]."""
    slope = vec3(0.0, 0.0, panel[b, j, i, SPRING] * (here[2] - panel[b, j, i, HEIGHT]))
    if s[PANEL] > 0.0:
        z = here[2]
        if z < REACH_M:
            t = z / REACH_M
            slope[2] -= panel[b, j, i, BARRIER] * (2.0 * (t - 1.0) * ti.log(t) + (t - 1.0) ** 2 / t) / REACH_M
        if panel[b, j, i, ADHESION] > 0.0 and z < s[ADHESION_RANGE]:
            t = z / s[ADHESION_RANGE]
            slope[2] += 4.0 * panel[b, j, i, ADHESION] * t * (1.0 - t * t)
        if panel[b, j, i, FRICTION] > 0.0:
            dx, dy = here[0] - panel[b, j, i, ANCHOR_X], here[1] - panel[b, j, i, ANCHOR_Y]
            pull = panel[b, j, i, FRICTION] / ti.sqrt(dx * dx + dy * dy + SLIP_M * SLIP_M)
            slope[0] += pull * dx
            slope[1] += pull * dy
    return slope


@ti.func
def panel_blocks(here, panel: ti.template(), s, blend, b, j, i):
    """Second derivatives [N/m], 3 x 3, their negative parts times ``blend``."""
    block = mat3(0.0)
    block[2, 2] = panel[b, j, i, SPRING]
    if s[PANEL] > 0.0:
        z = here[2]
        if z < REACH_M:
            t = z / REACH_M
            bend = 2.0 * ti.log(t) + 4.0 * (t - 1.0) / t - (t - 1.0) ** 2 / (t * t)
            block[2, 2] -= panel[b, j, i, BARRIER] * bend / (REACH_M * REACH_M)
        if panel[b, j, i, ADHESION] > 0.0 and z < s[ADHESION_RANGE]:
            t = z / s[ADHESION_RANGE]
            bend = 4.0 * panel[b, j, i, ADHESION] * (1.0 - 3.0 * t * t) / s[ADHESION_RANGE]
            if bend < 0.0:
                bend = blend * bend
            block[2, 2] += bend
        if panel[b, j, i, FRICTION] > 0.0:
            dx, dy = here[0] - panel[b, j, i, ANCHOR_X], here[1] - panel[b, j, i, ANCHOR_Y]
            root = ti.sqrt(dx * dx + dy * dy + SLIP_M * SLIP_M)
            stiff = panel[b, j, i, FRICTION] / root
            ux, uy = dx / root, dy / root
            block[0, 0] += stiff * (1.0 - ux * ux)
            block[1, 1] += stiff * (1.0 - uy * uy)
            block[0, 1] -= stiff * ux * uy
            block[1, 0] -= stiff * ux * uy
    return block
