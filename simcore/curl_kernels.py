"""Taichi kernels of rest curvature: the energy -(m_u x_uu + m_v x_vv) . n of each vertex.

With it the plate energy becomes one of the difference to the rest curvature (up to a constant). ``p`` is the weighted
sum of second differences, ``a`` and ``d`` the differences across a vertex along u and v; n = d x a / |d x a| points to
the camera on a flat sample. Neighbours beyond the border are replaced by the vertex itself. Every vertex stores the
derivatives by p, a and d, which it and its neighbours then gather.
"""

from simcore.lang import on_cpu, ti
from simcore.membrane_kernels import (
    array1,
    array3,
    array4,
    blocks4,
    identity,
    ints1,
    ints3,
    mat3,
    vec3,
    vectors3,
    vectors4,
)
from simcore.sum_kernels import add_up


@ti.func
def cross_matrix(v):
    return mat3([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@ti.func
def frame(x: ti.template(), m: ti.template(), n, w, j, i):
    rows, columns = x.shape[1], x.shape[2]
    c = x[n, j, i]
    left, right = x[n, j, ti.max(i - 1, 0)], x[n, j, ti.min(i + 1, columns - 1)]
    up, down = x[n, ti.max(j - 1, 0), i], x[n, ti.min(j + 1, rows - 1), i]
    p = m[w, j, i, 0] * (left + right - 2.0 * c) + m[w, j, i, 1] * (up + down - 2.0 * c)
    return p, right - left, down - up


@ti.kernel
def curl_energies(which: ints1, x: vectors3, m: array4, parts: array3, out: array1):
    """Add each energy [J] to ``out`` [n]; ``m`` [cloths, rows, columns, 2]: area * moment / h², zero where a second
    difference leaves the grid; ``parts`` [n, rows, columns] is scratch."""
    count, rows, columns = x.shape[0], x.shape[1], x.shape[2]
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows, columns):
        p, a, d = frame(x, m, n, which[n], j, i)
        parts[n, j, i] = -p.dot(d.cross(a).normalized())
    add_up(parts, out)


@ti.func
def weights(m: ti.template(), w, j, i, n):
    """Of neighbour n (0 itself, 1 left, 2 right, 3 up, 4 down) in p, a and d."""
    wp, wa, wd = -2.0 * (m[w, j, i, 0] + m[w, j, i, 1]), 0.0, 0.0
    if n == 1 or n == 2:
        wp = m[w, j, i, 0]
        wa = 2.0 * n - 3.0
    if n == 3 or n == 4:
        wp = m[w, j, i, 1]
        wd = 2.0 * n - 7.0
    return vec3(wp, wa, wd)


@ti.func
def step_to(n):
    """Rows and columns to neighbour n."""
    dj, di = 0, 0
    if n == 1:
        di = -1
    if n == 2:
        di = 1
    if n == 3:
        dj = -1
    if n == 4:
        dj = 1
    return dj, di


@ti.func
def neighbour(n, j, i, rows, columns):
    dj, di = step_to(n)
    return ti.min(ti.max(j + dj, 0), rows - 1), ti.min(ti.max(i + di, 0), columns - 1)


@ti.kernel
def curl_gradients(which: ints1, x: vectors3, m: array4, fixed: ints3, stored: vectors4, g: vectors3):
    """Add the derivatives to ``g`` [N], not where fixed; ``stored`` [n, rows, columns, 3] is scratch."""
    count, rows, columns = x.shape[0], x.shape[1], x.shape[2]
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows, columns):
        p, a, d = frame(x, m, n, which[n], j, i)
        big = d.cross(a)
        normal = big.normalized()
        by_normal = -(p - normal * normal.dot(p)) / big.norm()
        by_a, by_d = by_normal.cross(d), a.cross(by_normal)
        stored[n, j, i, 0] = -normal
        stored[n, j, i, 1] = by_a
        stored[n, j, i, 2] = by_d
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows, columns):
        w = which[n]
        if fixed[w, j, i] == 0:
            total = vec3(0.0, 0.0, 0.0)
            for c in range(5):
                dj, di = step_to(c)
                cj, ci = j + dj, i + di
                if cj >= 0 and ci >= 0 and cj < rows and ci < columns:
                    for k in range(5):
                        nj, ni = neighbour(k, cj, ci, rows, columns)
                        if nj == j and ni == i:
                            share = weights(m, w, cj, ci, k)
                            total += (
                                share[0] * stored[n, cj, ci, 0]
                                + share[1] * stored[n, cj, ci, 1]
                                + share[2] * stored[n, cj, ci, 2]
                            )
            g[n, j, i] += total


@ti.kernel
def curl_hessians(which: ints1, x: vectors3, m: array4, blend: array1, fixed: ints3, stored: blocks4, stencil: blocks4):
    """Add ``blend`` times the second derivatives to ``stencil``; ``stored`` [n, rows, columns, 5] is scratch."""
    count, rows, columns = x.shape[0], x.shape[1], x.shape[2]
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows, columns):
        p, a, d = frame(x, m, n, which[n], j, i)
        eye = identity()
        big = d.cross(a)
        size = big.norm()
        normal = big / size
        along = normal.dot(p)
        nn = normal.outer_product(normal)
        curve = (p.outer_product(normal) + normal.outer_product(p) + along * (eye - 3.0 * nn)) / (size * size)
        ca, cd = cross_matrix(a), cross_matrix(d)
        pa, pd = -(eye - nn) @ cd / size, (eye - nn) @ ca / size
        by_normal = -(p - normal * along) / size
        aa, dd = cd.transpose() @ curve @ cd, ca.transpose() @ curve @ ca
        ad = -cd.transpose() @ curve @ ca + cross_matrix(by_normal)
        stored[n, j, i, 0] = pa
        stored[n, j, i, 1] = pd
        stored[n, j, i, 2] = aa
        stored[n, j, i, 3] = ad
        stored[n, j, i, 4] = dd
    ti.loop_config(serialize=ti.static(on_cpu()))
    for n, j, i in ti.ndrange(count, rows, columns):
        w = which[n]
        if fixed[w, j, i] == 0:
            for centre in range(5):
                dj, di = step_to(centre)
                cj, ci = j + dj, i + di
                if cj >= 0 and ci >= 0 and cj < rows and ci < columns:
                    for k in range(5):
                        kj, ki = neighbour(k, cj, ci, rows, columns)
                        if kj == j and ki == i:
                            gather_row(
                                m, fixed, stored, stencil, blend[n], n, w, j, i, cj, ci, weights(m, w, cj, ci, k)
                            )


@ti.func
def gather_row(
    m: ti.template(), fixed: ti.template(), stored: ti.template(), stencil: ti.template(), blend, n, w, j, i, cj, ci, wk
):
    """What the energy of vertex (cj, ci) puts between vertex (j, i), of weights ``wk`` in it, and those after it."""
    rows, columns = stored.shape[1], stored.shape[2]
    pa, pd, aa = stored[n, cj, ci, 0], stored[n, cj, ci, 1], stored[n, cj, ci, 2]
    ad, dd = stored[n, cj, ci, 3], stored[n, cj, ci, 4]
    for o in range(5):
        wo = weights(m, w, cj, ci, o)
        oj, oi = neighbour(o, cj, ci, rows, columns)
        dj, di = oj - j, oi - i
        if (dj > 0 or (dj == 0 and di >= 0)) and fixed[w, oj, oi] == 0:
            block = (
                wk[0] * (wo[1] * pa + wo[2] * pd)
                + wk[1] * (wo[0] * pa.transpose() + wo[1] * aa + wo[2] * ad)
                + wk[2] * (wo[0] * pd.transpose() + wo[1] * ad.transpose() + wo[2] * dd)
            )
            # offset (dj, di) to its number in grid.OFFSETS
            where = 6
            if dj == 0:
                where = di
            elif dj == 1:
                where = 4 + di
            stencil[n, j, i, where] += blend * block
