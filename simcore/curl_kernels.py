"""Taichi kernels of rest curvature: the energy -(m_u x_uu + m_v x_vv) . n of each vertex.

With it the plate energy becomes one of the difference to the rest curvature (up to a constant). ``p`` is the weighted
sum of second differences, ``a`` and ``d`` the differences across a vertex along u and v; n = d x a / |d x a| points to
the camera on a flat sample. Neighbours beyond the border are replaced by the vertex itself.
"""

from simcore.kernels import array1, array3, ints1, ints2, ints3, mat3, point, vec3
from simcore.lang import ti


@ti.func
def cross_matrix(v):
    return mat3([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@ti.func
def frame(x: ti.template(), m: ti.template(), j, i):
    rows, columns = x.shape[0], x.shape[1]
    c = point(x, j, i)
    left, right = point(x, j, ti.max(i - 1, 0)), point(x, j, ti.min(i + 1, columns - 1))
    up, down = point(x, ti.max(j - 1, 0), i), point(x, ti.min(j + 1, rows - 1), i)
    p = m[j, i, 0] * (left + right - 2.0 * c) + m[j, i, 1] * (up + down - 2.0 * c)
    return p, right - left, down - up


@ti.kernel
def curl_energy(x: array3, m: array3) -> ti.f64:
    """Energy [J]; ``m`` [rows, columns, 2]: area * moment / h², zero where a second difference leaves the grid."""
    total = ti.cast(0.0, ti.f64)
    ti.loop_config(serialize=True)
    for j in range(x.shape[0]):
        for i in range(x.shape[1]):
            p, a, d = frame(x, m, j, i)
            total = total - p.dot(d.cross(a).normalized())
    return total


@ti.func
def weights(m: ti.template(), j, i, n):
    """Of neighbour n (0 itself, 1 left, 2 right, 3 up, 4 down) in p, a and d."""
    wp, wa, wd = -2.0 * (m[j, i, 0] + m[j, i, 1]), 0.0, 0.0
    if n == 1 or n == 2:
        wp = m[j, i, 0]
        wa = 2.0 * n - 3.0
    if n == 3 or n == 4:
        wp = m[j, i, 1]
        wd = 2.0 * n - 7.0
    return vec3(wp, wa, wd)


@ti.func
def neighbour(n, j, i, rows, columns):
    nj, ni = j, i
    if n == 1:
        ni = ti.max(i - 1, 0)
    if n == 2:
        ni = ti.min(i + 1, columns - 1)
    if n == 3:
        nj = ti.max(j - 1, 0)
    if n == 4:
        nj = ti.min(j + 1, rows - 1)
    return nj, ni


@ti.kernel
def curl_gradient(x: array3, m: array3, fixed: ints2, g: array3):
    """Add the derivative to ``g`` [N], not where fixed."""
    rows, columns = x.shape[0], x.shape[1]
    ti.loop_config(serialize=True)
    for j in range(rows):
        for i in range(columns):
            p, a, d = frame(x, m, j, i)
            big = d.cross(a)
            n = big.normalized()
            by_normal = -(p - n * n.dot(p)) / big.norm()
            by_p, by_a, by_d = -n, by_normal.cross(d), a.cross(by_normal)
            for k in range(5):
                w = weights(m, j, i, k)
                nj, ni = neighbour(k, j, i, rows, columns)
                if fixed[nj, ni] == 0:
                    total = w[0] * by_p + w[1] * by_a + w[2] * by_d
                    for r in ti.static(range(3)):
                        g[nj, ni, r] = g[nj, ni, r] + total[r]


@ti.kernel
def curl_hessian(x: array3, m: array3, blend: ti.f64, fixed: ints2, slot: ints3, indptr: ints1, values: array1):
    """Add ``blend`` times the second derivatives to the upper-triangle CSR ``values``."""
    rows, columns = x.shape[0], x.shape[1]
    ti.loop_config(serialize=True)
    for j in range(rows):
        for i in range(columns):
            p, a, d = frame(x, m, j, i)
            big = d.cross(a)
            size = big.norm()
            n = big / size
            along = n.dot(p)
            eye = mat3([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
            nn = n.outer_product(n)
            curve = (p.outer_product(n) + n.outer_product(p) + along * (eye - 3.0 * nn)) / (size * size)
            ca, cd = cross_matrix(a), cross_matrix(d)
            pa, pd = -(eye - nn) @ cd / size, (eye - nn) @ ca / size
            by_normal = -(p - n * along) / size
            aa, dd = cd.transpose() @ curve @ cd, ca.transpose() @ curve @ ca
            ad = -cd.transpose() @ curve @ ca + cross_matrix(by_normal)
            for k in range(5):
                wk = weights(m, j, i, k)
                kj, ki = neighbour(k, j, i, rows, columns)
                for o in range(5):
                    wo = weights(m, j, i, o)
                    oj, oi = neighbour(o, j, i, rows, columns)
                    dj, di = oj - kj, oi - ki
                    after = dj > 0 or (dj == 0 and di >= 0)
                    if after and fixed[kj, ki] == 0 and fixed[oj, oi] == 0:
                        block = (
                            wk[0] * (wo[1] * pa + wo[2] * pd)
                            + wk[1] * (wo[0] * pa.transpose() + wo[1] * aa + wo[2] * ad)
                            + wk[2] * (wo[0] * pd.transpose() + wo[1] * ad.transpose() + wo[2] * dd)
                        )
                        # offset (dj, di) to its number in grid.OFFSETS
                        where = 0
                        if dj == 0:
                            where = di
                        elif dj == 1:
                            where = 4 + di
                        else:
                            where = 6
                        base = 3 * (kj * columns + ki)
                        for r in ti.static(range(3)):
                            start = indptr[base + r] + 3 * slot[kj, ki, where] - r
                            for c in ti.static(range(3)):
                                if where > 0 or c >= r:
                                    values[start + c] = values[start + c] + blend * block[r, c]
