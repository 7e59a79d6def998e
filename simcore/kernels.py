"""Taichi kernels of a level: energy, gradient and Hessian of the membrane and of a 13-point quadratic form.

Two passes: cells store what vertices then gather in a fixed order, so that results do not depend on the number of
threads (same seed, same bits) and the same code runs on a GPU. Formulas: ``docs/conventions.md``.

Names: ``a`` = x_u and ``b`` = x_v at a cell's centre, ``q`` the cell's twist difference, so that x_u changes by q / hu
across the cell. A cell's corners are 0 (j, i), 1 (j, i+1), 2 (j+1, i), 3 (j+1, i+1).
"""

from simcore.lang import ti

vec3 = ti.types.vector(3, ti.f64)
mat3 = ti.types.matrix(3, 3, ti.f64)
array1 = ti.types.ndarray(dtype=ti.f64, ndim=1)
array2 = ti.types.ndarray(dtype=ti.f64, ndim=2)
array3 = ti.types.ndarray(dtype=ti.f64, ndim=3)
ints1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
ints2 = ti.types.ndarray(dtype=ti.i32, ndim=2)
ints3 = ti.types.ndarray(dtype=ti.i32, ndim=3)

# membrane settings, one float64 vector: see `Membrane.settings`
K_WEFT, K_WARP, K_BIAS, COS, SIN, STIFFENING, HU, HV = range(8)
SETTINGS = 8
HOURGLASS = 0.1
"""Share of the full hourglass stiffness: enough to hold a cell's in-plane shape, little enough not to lock a fold.

Cells that touch a held vertex have all of it: a pin that holds one point pulls on one corner of a cell, and a cell that
yields to that lets the whole sample sag.
"""


@ti.func
def point(x: ti.template(), j, i):
    return vec3(x[j, i, 0], x[j, i, 1], x[j, i, 2])


@ti.func
def tangents(x: ti.template(), s: ti.template(), j, i):
    p0, p1 = point(x, j, i), point(x, j, i + 1)
    p2, p3 = point(x, j + 1, i), point(x, j + 1, i + 1)
    a = (p1 + p3 - p0 - p2) / (2.0 * s[HU])
    b = (p2 + p3 - p0 - p1) / (2.0 * s[HV])
    q = p0 - p1 - p2 + p3
    return a, b, q


@ti.func
def material_strain(a, b, s: ti.template()):
    """Green-Lagrange strain (E_uu, E_vv, 2 E_uv) turned into the material's axes."""
    e0, e1, e2 = 0.5 * (a.dot(a) - 1.0), 0.5 * (b.dot(b) - 1.0), a.dot(b)
    c, n = s[COS], s[SIN]
    return vec3(
        c * c * e0 + n * n * e1 + c * n * e2,
        n * n * e0 + c * c * e1 - c * n * e2,
        -2.0 * c * n * e0 + 2.0 * c * n * e1 + (c * c - n * n) * e2,
    )


@ti.func
def stiffening(e, s: ti.template()):
    """1 / strain² for strains in tension, else 0."""
    result = ti.cast(0.0, ti.f64)
    if e > 0.0:
        result = s[STIFFENING]
    return result


@ti.func
def material_response(e, s: ti.template()):
    """Energy density, stress and tangent moduli in the material's axes."""
    g0, g1 = stiffening(e[0], s), stiffening(e[1], s)
    density = (
        0.5 * s[K_WEFT] * e[0] * e[0] * (1.0 + g0 * e[0] * e[0] / 6.0)
        + 0.5 * s[K_WARP] * e[1] * e[1] * (1.0 + g1 * e[1] * e[1] / 6.0)
        + 0.5 * s[K_BIAS] * e[2] * e[2]
    )
    stress = vec3(
        s[K_WEFT] * e[0] * (1.0 + g0 * e[0] * e[0] / 3.0),
        s[K_WARP] * e[1] * (1.0 + g1 * e[1] * e[1] / 3.0),
        s[K_BIAS] * e[2],
    )
    moduli = vec3(s[K_WEFT] * (1.0 + g0 * e[0] * e[0]), s[K_WARP] * (1.0 + g1 * e[1] * e[1]), s[K_BIAS])
    return density, stress, moduli


@ti.func
def rotation(s: ti.template()):
    """Rows: material strains as a function of the grid's (E_uu, E_vv, 2 E_uv)."""
    c, n = s[COS], s[SIN]
    return mat3([[c * c, n * n, c * n], [n * n, c * c, -c * n], [-2.0 * c * n, 2.0 * c * n, c * c - n * n]])


@ti.kernel
def membrane_energy(x: array3, s: array1, share: array2, cells: array2) -> ti.f64:
    """Membrane energy [J]; ``cells`` [rows-1, columns-1] receives each cell's; ``share`` is its hourglass share."""
    rows, columns = x.shape[0], x.shape[1]
    area = s[HU] * s[HV]
    for j, i in ti.ndrange(rows - 1, columns - 1):
        a, b, q = tangents(x, s, j, i)
        density, _, _ = material_response(material_strain(a, b, s), s)
        aq, bq = a.dot(q) / s[HU], b.dot(q) / s[HV]
        cells[j, i] = area * (density + (s[K_WEFT] * aq * aq + s[K_WARP] * bq * bq) * share[j, i] / 24.0)
    total = ti.cast(0.0, ti.f64)
    ti.loop_config(serialize=True)
    for j in range(rows - 1):
        for i in range(columns - 1):
            total = total + cells[j, i]
    return total


@ti.kernel
def membrane_cell_forces(x: array3, s: array1, share: array2, cell: array3):
    """Derivatives of each cell's energy by (a/(2hu), b/(2hv), q): 9 numbers, shape [rows-1, columns-1, 9]."""
    area = s[HU] * s[HV]
    for j, i in ti.ndrange(x.shape[0] - 1, x.shape[1] - 1):
        a, b, q = tangents(x, s, j, i)
        _, stress, _ = material_response(material_strain(a, b, s), s)
        t = rotation(s).transpose() @ stress
        ku, kv = (
            share[j, i] * s[K_WEFT] / (12.0 * s[HU] * s[HU]),
            share[j, i] * s[K_WARP] / (12.0 * s[HV] * s[HV]),
        )
        aq, bq = a.dot(q), b.dot(q)
        da = area * (t[0] * a + t[2] * b + ku * aq * q) / (2.0 * s[HU])
        db = area * (t[1] * b + t[2] * a + kv * bq * q) / (2.0 * s[HV])
        dq = area * (ku * aq * a + kv * bq * b)
        for r in ti.static(range(3)):
            cell[j, i, r] = da[r]
            cell[j, i, 3 + r] = db[r]
            cell[j, i, 6 + r] = dq[r]


@ti.kernel
def gather_gradient(x: array3, cell: array3, k: array3, loads: array3, fixed: ints2, g: array3):
    """Gradient at each vertex: cells around it + the quadratic form's product - loads; zero where fixed."""
    rows, columns = x.shape[0], x.shape[1]
    for j, i in ti.ndrange(rows, columns):
        total = -vec3(loads[j, i, 0], loads[j, i, 1], loads[j, i, 2])
        for dj, di in ti.static(ti.ndrange(2, 2)):
            # the cell (j - dj, i - di) has this vertex as corner (dj, di)
            cj, ci = j - dj, i - di
            if cj >= 0 and ci >= 0 and cj < rows - 1 and ci < columns - 1:
                sa, sb = 2.0 * di - 1.0, 2.0 * dj - 1.0
                for r in ti.static(range(3)):
                    total[r] += sa * cell[cj, ci, r] + sb * cell[cj, ci, 3 + r] + sa * sb * cell[cj, ci, 6 + r]
        total += form_product(x, k, j, i)
        if fixed[j, i] == 1:
            total = vec3(0.0, 0.0, 0.0)
        for r in ti.static(range(3)):
            g[j, i, r] = total[r]


@ti.func
def form_product(x: ti.template(), k: ti.template(), j, i):
    """Row of the 13-point form times the positions, from differences of positions: its rows add up to zero."""
    rows, columns = x.shape[0], x.shape[1]
    here = point(x, j, i)
    total = vec3(0.0, 0.0, 0.0)
    for m, dj, di in ti.static([(1, 0, 1), (2, 0, 2), (3, 1, -1), (4, 1, 0), (5, 1, 1), (6, 2, 0)]):
        if j + dj < rows and i + di < columns and i + di >= 0:
            total += k[j, i, m] * (point(x, j + dj, i + di) - here)
        if j - dj >= 0 and i - di < columns and i - di >= 0:
            total += k[j - dj, i - di, m] * (point(x, j - dj, i - di) - here)
    return total


@ti.kernel
def form_energy(x: array3, k: array3, cells: array2) -> ti.f64:
    """½ xᵀ K x of the 13-point form [J], as -½ Σ K_ij |x_i - x_j|²: rounds as cells do, not as the sample."""
    rows, columns = x.shape[0], x.shape[1]
    for j, i in ti.ndrange(rows, columns):
        energy = ti.cast(0.0, ti.f64)
        for m, dj, di in ti.static([(1, 0, 1), (2, 0, 2), (3, 1, -1), (4, 1, 0), (5, 1, 1), (6, 2, 0)]):
            if j + dj < rows and i + di < columns and i + di >= 0:
                apart = point(x, j + dj, i + di) - point(x, j, i)
                energy -= 0.5 * k[j, i, m] * apart.dot(apart)
        cells[j, i] = energy
    total = ti.cast(0.0, ti.f64)
    ti.loop_config(serialize=True)
    for j in range(rows):
        for i in range(columns):
            total = total + cells[j, i]
    return total


@ti.func
def outer(a, b):
    return a.outer_product(b)


@ti.func
def blended_stress(t, blend):
    """The 2x2 membrane stress with its compressive part scaled by ``blend`` (0: positive semi-definite, 1: exact)."""
    mean, half = 0.5 * (t[0] + t[1]), 0.5 * (t[0] - t[1])
    radius = ti.sqrt(half * half + t[2] * t[2])
    high, low = mean + radius, mean - radius
    fh, fl = high, low
    if fh < 0.0:
        fh = blend * fh
    if fl < 0.0:
        fl = blend * fl
    result = t
    if radius > 1e-300:
        # f(T) = alpha I + beta (T - mean I)
        alpha, beta = 0.5 * (fh + fl), 0.5 * (fh - fl) / radius
        result = vec3(alpha + beta * half, alpha - beta * half, beta * t[2])
    else:
        result = vec3(fh, fh, 0.0)
    return result


@ti.kernel
def membrane_cell_hessians(x: array3, s: array1, share: array2, blend: ti.f64, cell: array3):
    """Second derivatives of each cell by (a/(2hu), b/(2hv), q): blocks aa, ab, aq, bb, bq, qq; [rows-1, columns-1, 54].

    ``blend`` 1 gives the exact Hessian, 0 one that is positive semi-definite.
    """
    area = s[HU] * s[HV]
    eye = mat3([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    for j, i in ti.ndrange(x.shape[0] - 1, x.shape[1] - 1):
        a, b, q = tangents(x, s, j, i)
        _, stress, moduli = material_response(material_strain(a, b, s), s)
        turn = rotation(s)
        t = blended_stress(turn.transpose() @ stress, blend)
        d = mat3([[moduli[0], 0.0, 0.0], [0.0, moduli[1], 0.0], [0.0, 0.0, moduli[2]]])
        c = turn.transpose() @ d @ turn
        ku, kv = (
            share[j, i] * s[K_WEFT] / (12.0 * s[HU] * s[HU]),
            share[j, i] * s[K_WARP] / (12.0 * s[HV] * s[HV]),
        )
        aq, bq = blend * a.dot(q), blend * b.dot(q)
        p0, p2 = c[0, 0] * a + c[0, 2] * b, c[0, 2] * a + c[2, 2] * b
        w1, w2 = c[1, 1] * b + c[1, 2] * a, c[1, 2] * b + c[2, 2] * a
        aa = outer(a, p0) + outer(b, p2) + t[0] * eye + ku * outer(q, q)
        ab = outer(a, c[0, 1] * b + c[0, 2] * a) + outer(b, w2) + t[2] * eye
        bb = outer(b, w1) + outer(a, w2) + t[1] * eye + kv * outer(q, q)
        aq_block = ku * (outer(q, a) + aq * eye)
        bq_block = kv * (outer(q, b) + bq * eye)
        qq = ku * outer(a, a) + kv * outer(b, b)
        fu, fv = 1.0 / (2.0 * s[HU]), 1.0 / (2.0 * s[HV])
        for r in ti.static(range(3)):
            for m in ti.static(range(3)):
                n = 3 * r + m
                cell[j, i, n] = area * fu * fu * aa[r, m]
                cell[j, i, 9 + n] = area * fu * fv * ab[r, m]
                cell[j, i, 18 + n] = area * fu * aq_block[r, m]
                cell[j, i, 27 + n] = area * fv * fv * bb[r, m]
                cell[j, i, 36 + n] = area * fv * bq_block[r, m]
                cell[j, i, 45 + n] = area * qq[r, m]


@ti.func
def corner_block(cell: ti.template(), cj, ci, j0, i0, j1, i1):
    """Block of cell (cj, ci) between its corners (j0, i0) and (j1, i1), each 0 or 1."""
    a0, b0 = 2.0 * i0 - 1.0, 2.0 * j0 - 1.0
    a1, b1 = 2.0 * i1 - 1.0, 2.0 * j1 - 1.0
    q0, q1 = a0 * b0, a1 * b1
    block = mat3(0.0)
    for r in ti.static(range(3)):
        for m in ti.static(range(3)):
            n, w = 3 * r + m, 3 * m + r
            block[r, m] = (
                a0 * a1 * cell[cj, ci, n]
                + a0 * b1 * cell[cj, ci, 9 + n]
                + b0 * a1 * cell[cj, ci, 9 + w]
                + a0 * q1 * cell[cj, ci, 18 + n]
                + q0 * a1 * cell[cj, ci, 18 + w]
                + b0 * b1 * cell[cj, ci, 27 + n]
                + b0 * q1 * cell[cj, ci, 36 + n]
                + q0 * b1 * cell[cj, ci, 36 + w]
                + q0 * q1 * cell[cj, ci, 45 + n]
            )
    return block


@ti.func
def pair_block(cell: ti.template(), rows, columns, j, i, dj, di):
    """Sum over the cells that hold both vertex (j, i) and (j + dj, i + di)."""
    block = mat3(0.0)
    for oj, oi in ti.static(ti.ndrange(2, 2)):
        # this vertex is corner (oj, oi) of the cell
        cj, ci = j - oj, i - oi
        j1, i1 = oj + dj, oi + di
        if cj >= 0 and ci >= 0 and cj < rows - 1 and ci < columns - 1 and j1 >= 0 and j1 <= 1 and i1 >= 0 and i1 <= 1:
            block += corner_block(cell, cj, ci, oj, oi, j1, i1)
    return block


@ti.kernel
def assemble(
    cell: array3, k: array3, vertex: array3, fixed: ints2, slot: ints3, indptr: ints1, scale: ti.f64, values: array1
):
    """Upper-triangle CSR values: cells + 13-point form + symmetric vertex blocks (xx, yy, zz, xy, xz, yz); fixed rows
    and columns become ``scale`` times the identity."""
    rows, columns = k.shape[0], k.shape[1]
    for j, i in ti.ndrange(rows, columns):
        base = 3 * (j * columns + i)
        for m, dj, di in ti.static([(0, 0, 0), (1, 0, 1), (2, 0, 2), (3, 1, -1), (4, 1, 0), (5, 1, 1), (6, 2, 0)]):
            where = slot[j, i, m]
            if where >= 0:
                block = mat3(0.0)
                if fixed[j, i] == 0 and fixed[j + dj, i + di] == 0:
                    if ti.static(m != 2 and m != 6):
                        block = pair_block(cell, rows, columns, j, i, dj, di)
                    for r in ti.static(range(3)):
                        block[r, r] += k[j, i, m]
                    if ti.static(m == 0):
                        for r in ti.static(range(3)):
                            block[r, r] += vertex[j, i, r]
                        block[0, 1] += vertex[j, i, 3]
                        block[0, 2] += vertex[j, i, 4]
                        block[1, 2] += vertex[j, i, 5]
                elif ti.static(m == 0):
                    for r in ti.static(range(3)):
                        block[r, r] = scale
                for r in ti.static(range(3)):
                    start = indptr[base + r] + 3 * where - r
                    for n in ti.static(range(3)):
                        if ti.static(m != 0 or n >= r):
                            values[start + n] = block[r, n]
