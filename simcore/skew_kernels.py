"""Taichi kernels of what couples bending with twist: the part of its form that the 13-point stencil does not hold.

Only cloth that lies off grain has any (``PlateRigidity.turned``). ``skew`` [cloths, rows, columns, 4]: coefficients to
the neighbours of ``grid.SKEW_OFFSETS`` [N/m]; the form is -½ Σ K_ij |x_i - x_j|², as in ``kernels``.
"""

from simcore.lang import on_cpu, ti
from simcore.membrane_kernels import array1, array3, array4, ints1, ints3, vec3, vectors3
from simcore.sum_kernels import add_up


@ti.kernel
def skew_energies(which: ints1, x: vectors3, skew: array4, parts: array3, out: array1):
    """Add each energy [J] to ``out`` [n]; ``parts`` [n, rows, columns] is scratch."""
    count, rows, columns = x.shape[0], x.shape[1], x.shape[2]
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows, columns):
        b = which[n]
        here = x[n, j, i]
        energy = ti.cast(0.0, ti.f64)
        for m, dj, di in ti.static([(0, 1, -2), (1, 1, 2), (2, 2, -1), (3, 2, 1)]):
            if j + dj < rows and i + di < columns and i + di >= 0:
                apart = x[n, j + dj, i + di] - here
                energy -= 0.5 * skew[b, j, i, m] * apart.dot(apart)
        parts[n, j, i] = energy
    add_up(parts, out)


@ti.kernel
def skew_gradients(which: ints1, x: vectors3, skew: array4, fixed: ints3, g: vectors3):
    """Add the derivatives to ``g`` [N], not where fixed."""
    count, rows, columns = x.shape[0], x.shape[1], x.shape[2]
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows, columns):
        b = which[n]
        if fixed[b, j, i] == 0:
            here = x[n, j, i]
            total = vec3(0.0, 0.0, 0.0)
            for m, dj, di in ti.static([(0, 1, -2), (1, 1, 2), (2, 2, -1), (3, 2, 1)]):
                if j + dj < rows and i + di < columns and i + di >= 0:
                    total += skew[b, j, i, m] * (x[n, j + dj, i + di] - here)
                if j - dj >= 0 and i - di < columns and i - di >= 0:
                    total += skew[b, j - dj, i - di, m] * (x[n, j - dj, i - di] - here)
            g[n, j, i] += total
