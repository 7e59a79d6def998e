"""Taichi kernels of many cloths on one grid: energy, gradient and Hessian of membrane, bending form, loads and panel.

Cells store what vertices then gather in a fixed order, so that results do not depend on the number of threads (same
seed, same bits) and the same code runs on a GPU. Formulas: ``docs/conventions.md``.

Every array has a leading axis. ``which`` [n] says which cloth of the constant fields (settings, hourglass shares,
bending, loads, held vertices, panel) each of the n positions belongs to. A cell's corners are 0 (j, i), 1 (j, i+1),
2 (j+1, i), 3 (j+1, i+1).
"""

from simcore.lang import on_cpu, ti
from simcore.membrane_kernels import (
    K_BIAS,
    K_WARP,
    K_WEFT,
    array1,
    array2,
    array3,
    array4,
    blocks4,
    cell_blocks,
    cell_energy,
    cell_forces,
    identity,
    ints1,
    ints3,
    mat3,
    settings_of,
    vec3,
    vectors3,
    vectors4,
)
from simcore.panel_kernels import panel_blocks, panel_energy, panel_slope
from simcore.sum_kernels import add_up


@ti.kernel
def energies(
    which: ints1,
    x: vectors3,
    settings: array2,
    hourglass: array3,
    bending: array4,
    load: vectors3,
    fixed: ints3,
    panel: array4,
    parts: array3,
    out: array1,
):
    """Add the energy [J] of each cloth to ``out`` [n]; ``parts`` [n, rows, columns] is scratch.

    The bending form is -½ Σ K_ij |x_i - x_j|²: it rounds as cells do, not as the sample.
    """
    count, rows, columns = x.shape[0], x.shape[1], x.shape[2]
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows, columns):
        b = which[n]
        s = settings_of(settings, b)
        here = x[n, j, i]
        energy = -load[b, j, i].dot(here)
        for m, dj, di in ti.static([(1, 0, 1), (2, 0, 2), (3, 1, -1), (4, 1, 0), (5, 1, 1), (6, 2, 0)]):
            if j + dj < rows and i + di < columns and i + di >= 0:
                apart = x[n, j + dj, i + di] - here
                energy -= 0.5 * bending[b, j, i, m] * apart.dot(apart)
        if fixed[b, j, i] == 0:
            energy += panel_energy(here, panel, s, b, j, i)
        if j < rows - 1 and i < columns - 1:
            energy += cell_energy(x, s, hourglass[b, j, i], n, j, i)
        parts[n, j, i] = energy
    add_up(parts, out)


@ti.kernel
def gradients(
    which: ints1,
    x: vectors3,
    settings: array2,
    hourglass: array3,
    bending: array4,
    load: vectors3,
    fixed: ints3,
    panel: array4,
    cells: vectors4,
    out: vectors3,
):
    """Derivative of each energy [N], zero where held; ``cells`` [n, rows-1, columns-1, 3] is scratch."""
    count, rows, columns = x.shape[0], x.shape[1], x.shape[2]
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows - 1, columns - 1):
        b = which[n]
        if any_free(fixed, b, j, i):
            da, db, dq = cell_forces(x, settings_of(settings, b), hourglass[b, j, i], n, j, i)
            cells[n, j, i, 0] = da
            cells[n, j, i, 1] = db
            cells[n, j, i, 2] = dq
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows, columns):
        b = which[n]
        total = vec3(0.0, 0.0, 0.0)
        if fixed[b, j, i] == 0:
            here = x[n, j, i]
            total = form_product(x, bending, n, b, j, i) - load[b, j, i]
            total += panel_slope(here, panel, settings_of(settings, b), b, j, i)
            for dj, di in ti.ndrange(2, 2):
                # the cell (j - dj, i - di) has this vertex as corner (dj, di)
                cj, ci = j - dj, i - di
                if cj >= 0 and ci >= 0 and cj < rows - 1 and ci < columns - 1:
                    sa, sb = 2.0 * di - 1.0, 2.0 * dj - 1.0
                    total += sa * cells[n, cj, ci, 0] + sb * cells[n, cj, ci, 1] + sa * sb * cells[n, cj, ci, 2]
        out[n, j, i] = total


@ti.func
def any_free(fixed: ti.template(), b, j, i):
    """A corner of cell (j, i) is not held: what the cell does is of no consequence otherwise."""
    return fixed[b, j, i] + fixed[b, j, i + 1] + fixed[b, j + 1, i] + fixed[b, j + 1, i + 1] < 4


@ti.func
def form_product(x: ti.template(), k: ti.template(), n, b, j, i):
    """Row of the 13-point form times the positions, from differences of positions: its rows add up to zero."""
    rows, columns = x.shape[1], x.shape[2]
    here = x[n, j, i]
    total = vec3(0.0, 0.0, 0.0)
    for m, dj, di in ti.static([(1, 0, 1), (2, 0, 2), (3, 1, -1), (4, 1, 0), (5, 1, 1), (6, 2, 0)]):
        if j + dj < rows and i + di < columns and i + di >= 0:
            total += k[b, j, i, m] * (x[n, j + dj, i + di] - here)
        if j - dj >= 0 and i - di < columns and i - di >= 0:
            total += k[b, j - dj, i - di, m] * (x[n, j - dj, i - di] - here)
    return total


@ti.func
def offset(m):
    """``grid.OFFSETS[m]``: a loop over blocks that is not unrolled is as fast, and compiled sooner."""
    dj = m // 3
    di = m - 3 * dj
    if dj == 1:
        di -= 1
    return dj, di


@ti.kernel
def hessians(
    which: ints1,
    x: vectors3,
    settings: array2,
    hourglass: array3,
    bending: array4,
    fixed: ints3,
    panel: array4,
    blend: array1,
    shift: array3,
    cells: blocks4,
    out: blocks4,
):
    """Second derivatives as stencils [n, rows, columns, 7] of 3 x 3 blocks to the neighbours of ``grid.OFFSETS`` [N/m].

    ``blend`` [n]: 1 gives the exact Hessian, 0 one that is positive semi-definite. ``shift`` [n, rows, columns] is
    added to the diagonal. Rows and columns of held vertices become those of a multiple of the identity. ``cells``
    [n, rows-1, columns-1, 6] of blocks is scratch.
    """
    count, rows, columns = x.shape[0], x.shape[1], x.shape[2]
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows - 1, columns - 1):
        b = which[n]
        if any_free(fixed, b, j, i):
            cell_blocks(x, settings_of(settings, b), hourglass[b, j, i], blend[n], n, j, i, cells)
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows, columns):
        b = which[n]
        s = settings_of(settings, b)
        eye = identity()
        held = fixed[b, j, i] == 1
        for m in range(7):
            dj, di = offset(m)
            block = mat3(0.0)
            if j + dj < rows and i + di < columns and i + di >= 0 and not held:
                block = bending[b, j, i, m] * (1 - fixed[b, j + dj, i + di]) * eye
            out[n, j, i, m] = block
        if held:
            out[n, j, i, 0] = ti.max(s[K_WEFT], ti.max(s[K_WARP], s[K_BIAS])) * eye
        else:
            own = shift[n, j, i] * eye + panel_blocks(x[n, j, i], panel, s, blend[n], b, j, i)
            right, below = mat3(0.0), mat3(0.0)
            for oj, oi in ti.ndrange(2, 2):
                # this vertex is corner (oj, oi) of a cell; ``across`` is the block to the opposite corner below
                mj, mi = j - oj, i - oi
                if mj >= 0 and mi >= 0 and mj < rows - 1 and mi < columns - 1:
                    sa, sb = 2.0 * oi - 1.0, 2.0 * oj - 1.0
                    aa, ab, aq = cells[n, mj, mi, 0], cells[n, mj, mi, 1], cells[n, mj, mi, 2]
                    bb, bq, qq = cells[n, mj, mi, 3], cells[n, mj, mi, 4], cells[n, mj, mi, 5]
                    ab_even, ab_odd = ab + ab.transpose(), ab - ab.transpose()
                    aq_even, aq_odd = aq + aq.transpose(), aq - aq.transpose()
                    bq_even, bq_odd = bq + bq.transpose(), bq - bq.transpose()
                    own += aa + bb + qq + sa * sb * ab_even + sb * aq_even + sa * bq_even
                    if oi == 0:
                        right += bb - aa - qq - sb * (ab_odd + aq_even) + bq_odd
                    if oj == 0:
                        below += aa - bb - qq + sa * (ab_odd - bq_even) + aq_odd
                        if fixed[b, j + 1, i + 1 - 2 * oi] == 0:
                            across = qq - aa - bb + sa * (ab_even + bq_odd) - aq_odd
                            out[n, j, i, 5 - 2 * oi] += across
            out[n, j, i, 0] += own
            if i + 1 < columns and fixed[b, j, ti.min(i + 1, columns - 1)] == 0:
                out[n, j, i, 1] += right
            if j + 1 < rows and fixed[b, ti.min(j + 1, rows - 1), i] == 0:
                out[n, j, i, 4] += below
