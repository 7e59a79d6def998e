"""Taichi kernels of many cloths on one grid: energy, gradient and Hessian of membrane, bending form, loads and panel.

Cells store what vertices then gather in a fixed order, so that results do not depend on the number of threads (same
seed, same bits) and the same code runs on a GPU. Formulas: ``docs/conventions.md``.

Every array has a leading axis. ``which`` [n] says which cloth of the constant fields (settings, hourglass shares,
bending, loads, held vertices, panel) each of the n positions belongs to. A cell's corners are 0 (j, i), 1 (j, i+1),
2 (j+1, i), 3 (j+1, i+1).
"""

from simcore.lang import ti
from simcore.membrane_kernels import (
    HU,
    HV,
    K_BIAS,
    K_WARP,
    K_WEFT,
    array1,
    array2,
    array3,
    array4,
    cell_blocks,
    cell_energy,
    cell_forces,
    ints1,
    ints3,
    mat3,
    point,
    settings_of,
    vec3,
)
from simcore.panel_kernels import panel_blocks, panel_energy, panel_slope

STENCIL = 63
"""Numbers a vertex has in the Hessian: 3 x 3 blocks to the seven neighbours of ``grid.OFFSETS``, row by row."""


@ti.kernel
def energies(
    which: ints1,
    x: array4,
    settings: array2,
    hourglass: array3,
    bending: array4,
    load: array4,
    fixed: ints3,
    panel: array4,
    parts: array3,
    out: array1,
):
    """Energy [J] of each cloth into ``out`` [n]; ``parts`` [n, rows, columns] is scratch.

    The bending form is -½ Σ K_ij |x_i - x_j|²: it rounds as cells do, not as the sample.
    """
    count, rows, columns = x.shape[0], x.shape[1], x.shape[2]
    for n, j, i in ti.ndrange(count, rows, columns):
        b = which[n]
        s = settings_of(settings, b)
        here = point(x, n, j, i)
        energy = -(load[b, j, i, 0] * here[0] + load[b, j, i, 1] * here[1] + load[b, j, i, 2] * here[2])
        for m, dj, di in ti.static([(1, 0, 1), (2, 0, 2), (3, 1, -1), (4, 1, 0), (5, 1, 1), (6, 2, 0)]):
            if j + dj < rows and i + di < columns and i + di >= 0:
                apart = point(x, n, j + dj, i + di) - here
                energy -= 0.5 * bending[b, j, i, m] * apart.dot(apart)
        if fixed[b, j, i] == 0:
            energy += panel_energy(here, panel, s, b, j, i)
        if j < rows - 1 and i < columns - 1:
            energy += cell_energy(x, s, hourglass[b, j, i], n, j, i)
        parts[n, j, i] = energy
    for n in range(count):
        total = ti.cast(0.0, ti.f64)
        for j in range(rows):
            for i in range(columns):
                total = total + parts[n, j, i]
        out[n] = total


@ti.kernel
def gradients(
    which: ints1,
    x: array4,
    settings: array2,
    hourglass: array3,
    bending: array4,
    load: array4,
    fixed: ints3,
    panel: array4,
    cells: array4,
    out: array4,
):
    """Derivative of each energy [N], zero where held; ``cells`` [n, rows-1, columns-1, 9] is scratch."""
    count, rows, columns = x.shape[0], x.shape[1], x.shape[2]
    for n, j, i in ti.ndrange(count, rows - 1, columns - 1):
        b = which[n]
        da, db, dq = cell_forces(x, settings_of(settings, b), hourglass[b, j, i], n, j, i)
        for r in ti.static(range(3)):
            cells[n, j, i, r] = da[r]
            cells[n, j, i, 3 + r] = db[r]
            cells[n, j, i, 6 + r] = dq[r]
    for n, j, i in ti.ndrange(count, rows, columns):
        b = which[n]
        total = vec3(0.0, 0.0, 0.0)
        if fixed[b, j, i] == 0:
            here = point(x, n, j, i)
            total = form_product(x, bending, n, b, j, i) - vec3(load[b, j, i, 0], load[b, j, i, 1], load[b, j, i, 2])
            total += panel_slope(here, panel, settings_of(settings, b), b, j, i)
            for dj, di in ti.static(ti.ndrange(2, 2)):
                # the cell (j - dj, i - di) has this vertex as corner (dj, di)
                cj, ci = j - dj, i - di
                if cj >= 0 and ci >= 0 and cj < rows - 1 and ci < columns - 1:
                    sa, sb = 2.0 * di - 1.0, 2.0 * dj - 1.0
                    for r in ti.static(range(3)):
                        total[r] += (
                            sa * cells[n, cj, ci, r] + sb * cells[n, cj, ci, 3 + r] + sa * sb * cells[n, cj, ci, 6 + r]
                        )
        for r in ti.static(range(3)):
            out[n, j, i, r] = total[r]


@ti.func
def form_product(x: ti.template(), k: ti.template(), n, b, j, i):
    """Row of the 13-point form times the positions, from differences of positions: its rows add up to zero."""
    rows, columns = x.shape[1], x.shape[2]
    here = point(x, n, j, i)
    total = vec3(0.0, 0.0, 0.0)
    for m, dj, di in ti.static([(1, 0, 1), (2, 0, 2), (3, 1, -1), (4, 1, 0), (5, 1, 1), (6, 2, 0)]):
        if j + dj < rows and i + di < columns and i + di >= 0:
            total += k[b, j, i, m] * (point(x, n, j + dj, i + di) - here)
        if j - dj >= 0 and i - di < columns and i - di >= 0:
            total += k[b, j - dj, i - di, m] * (point(x, n, j - dj, i - di) - here)
    return total


@ti.func
def corner_block(cell: ti.template(), n, cj, ci, j0, i0, j1, i1):
    """Block of cell (cj, ci) between its corners (j0, i0) and (j1, i1), each 0 or 1."""
    a0, b0 = 2.0 * i0 - 1.0, 2.0 * j0 - 1.0
    a1, b1 = 2.0 * i1 - 1.0, 2.0 * j1 - 1.0
    q0, q1 = a0 * b0, a1 * b1
    block = mat3(0.0)
    for r in ti.static(range(3)):
        for m in ti.static(range(3)):
            k, w = 3 * r + m, 3 * m + r
            block[r, m] = (
                a0 * a1 * cell[n, cj, ci, k]
                + a0 * b1 * cell[n, cj, ci, 9 + k]
                + b0 * a1 * cell[n, cj, ci, 9 + w]
                + a0 * q1 * cell[n, cj, ci, 18 + k]
                + q0 * a1 * cell[n, cj, ci, 18 + w]
                + b0 * b1 * cell[n, cj, ci, 27 + k]
                + b0 * q1 * cell[n, cj, ci, 36 + k]
                + q0 * b1 * cell[n, cj, ci, 36 + w]
                + q0 * q1 * cell[n, cj, ci, 45 + k]
            )
    return block


@ti.func
def pair_block(cell: ti.template(), n, rows, columns, j, i, dj, di):
    """Sum over the cells that hold both vertex (j, i) and (j + dj, i + di)."""
    block = mat3(0.0)
    for oj, oi in ti.static(ti.ndrange(2, 2)):
        # this vertex is corner (oj, oi) of the cell
        cj, ci = j - oj, i - oi
        j1, i1 = oj + dj, oi + di
        if cj >= 0 and ci >= 0 and cj < rows - 1 and ci < columns - 1 and j1 >= 0 and j1 <= 1 and i1 >= 0 and i1 <= 1:
            block += corner_block(cell, n, cj, ci, oj, oi, j1, i1)
    return block


@ti.kernel
def hessians(
    which: ints1,
    x: array4,
    settings: array2,
    hourglass: array3,
    bending: array4,
    fixed: ints3,
    panel: array4,
    blend: array1,
    shift: array3,
    cells: array4,
    out: array4,
):
    """Second derivatives as stencils [n, rows, columns, 63] [N/m]; ``cells`` [n, rows-1, columns-1, 54] is scratch.

    ``blend`` [n]: 1 gives the exact Hessian, 0 one that is positive semi-definite. ``shift`` [n, rows, columns] is
    added to the diagonal. Rows and columns of held vertices become those of a multiple of the identity.
    """
    count, rows, columns = x.shape[0], x.shape[1], x.shape[2]
    for n, j, i in ti.ndrange(count, rows - 1, columns - 1):
        b = which[n]
        cell_blocks(x, settings_of(settings, b), hourglass[b, j, i], blend[n], n, j, i, cells)
    for n, j, i in ti.ndrange(count, rows, columns):
        b = which[n]
        s = settings_of(settings, b)
        for m, dj, di in ti.static([(0, 0, 0), (1, 0, 1), (2, 0, 2), (3, 1, -1), (4, 1, 0), (5, 1, 1), (6, 2, 0)]):
            block = mat3(0.0)
            if j + dj < rows and i + di < columns and i + di >= 0:
                if fixed[b, j, i] == 0 and fixed[b, j + dj, i + di] == 0:
                    if ti.static(m != 2 and m != 6):
                        block = pair_block(cells, n, rows, columns, j, i, dj, di)
                    for r in ti.static(range(3)):
                        block[r, r] += bending[b, j, i, m]
                    if ti.static(m == 0):
                        block += panel_blocks(point(x, n, j, i), panel, s, blend[n], b, j, i)
                        for r in ti.static(range(3)):
                            block[r, r] += shift[n, j, i]
                elif ti.static(m == 0):
                    for r in ti.static(range(3)):
                        block[r, r] = ti.max(s[K_WEFT], ti.max(s[K_WARP], s[K_BIAS]))
            for r in ti.static(range(3)):
                for c in ti.static(range(3)):
                    out[n, j, i, 9 * m + 3 * r + c] = block[r, c]
