"""Taichi functions of one cell of the membrane.

Names: ``a`` = x_u and ``b`` = x_v at the cell's centre, ``q`` its twist difference, so that x_u changes by q / hu
across the cell; ``s`` a cloth's settings.
"""

from simcore.lang import ti

vec3 = ti.types.vector(3, ti.f64)
mat3 = ti.types.matrix(3, 3, ti.f64)
array1 = ti.types.ndarray(dtype=ti.f64, ndim=1)
array2 = ti.types.ndarray(dtype=ti.f64, ndim=2)
array3 = ti.types.ndarray(dtype=ti.f64, ndim=3)
array4 = ti.types.ndarray(dtype=ti.f64, ndim=4)
vectors3 = ti.types.ndarray(dtype=vec3, ndim=3)
vectors4 = ti.types.ndarray(dtype=vec3, ndim=4)
blocks4 = ti.types.ndarray(dtype=mat3, ndim=4)
ints1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
ints3 = ti.types.ndarray(dtype=ti.i32, ndim=3)

K_WEFT, K_WARP, K_BIAS, COS, SIN, STIFFENING, HU, HV, ADHESION_RANGE, PANEL = range(10)
SETTINGS = 10
"""Numbers of a cloth: stretch stiffnesses [N/m], turn of the material's axes, 1 / strain² at which moduli have doubled,
cell [m], range of the panel's adhesion [m], whether there is a panel."""
vec_settings = ti.types.vector(SETTINGS, ti.f64)

HOURGLASS = 0.1
"""Share of the full hourglass stiffness: enough to hold a cell's in-plane shape, little enough not to lock a fold.

Cells that touch a held vertex have all of it: a pin that holds one point pulls on one corner of a cell, and a cell that
yields to that lets the whole sample sag.
"""


@ti.func
def identity():
    """Made in the loop that uses it: Taichi 1.7 puts what loops share where a GPU cannot read float64."""
    return mat3([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@ti.func
def settings_of(settings: ti.template(), b):
    s = vec_settings(0.0)
    for r in ti.static(range(SETTINGS)):
        s[r] = settings[b, r]
    return s


@ti.func
def tangents(x: ti.template(), s, n, j, i):
    p0, p1, p2, p3 = x[n, j, i], x[n, j, i + 1], x[n, j + 1, i], x[n, j + 1, i + 1]
    a = (p1 + p3 - p0 - p2) / (2.0 * s[HU])
    b = (p2 + p3 - p0 - p1) / (2.0 * s[HV])
    q = p0 - p1 - p2 + p3
    return a, b, q


@ti.func
def rotation(s):
    """Rows: material strains as a function of the grid's (E_uu, E_vv, 2 E_uv)."""
    c, n = s[COS], s[SIN]
    return mat3([[c * c, n * n, c * n], [n * n, c * c, -c * n], [-2.0 * c * n, 2.0 * c * n, c * c - n * n]])


@ti.func
def material_strain(a, b, s):
    """Green-Lagrange strain (E_uu, E_vv, 2 E_uv) turned into the material's axes."""
    return rotation(s) @ vec3(0.5 * (a.dot(a) - 1.0), 0.5 * (b.dot(b) - 1.0), a.dot(b))


@ti.func
def stiffening(e, s):
    """1 / strain² for strains in tension, else 0."""
    result = ti.cast(0.0, ti.f64)
    if e > 0.0:
        result = s[STIFFENING]
    return result


@ti.func
def material_response(e, s):
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
def cell_energy(x: ti.template(), s, share, n, j, i):
    """[J]; ``share`` is the cell's hourglass share."""
    a, b, q = tangents(x, s, n, j, i)
    density, _, _ = material_response(material_strain(a, b, s), s)
    aq, bq = a.dot(q) / s[HU], b.dot(q) / s[HV]
    return s[HU] * s[HV] * (density + (s[K_WEFT] * aq * aq + s[K_WARP] * bq * bq) * share / 24.0)


@ti.func
def cell_forces(x: ti.template(), s, share, n, j, i):
    """Derivatives of the cell's energy by a / (2 hu), b / (2 hv) and q."""
    area = s[HU] * s[HV]
    a, b, q = tangents(x, s, n, j, i)
    _, stress, _ = material_response(material_strain(a, b, s), s)
    t = rotation(s).transpose() @ stress
    ku, kv = share * s[K_WEFT] / (12.0 * s[HU] * s[HU]), share * s[K_WARP] / (12.0 * s[HV] * s[HV])
    aq, bq = a.dot(q), b.dot(q)
    da = area * (t[0] * a + t[2] * b + ku * aq * q) / (2.0 * s[HU])
    db = area * (t[1] * b + t[2] * a + kv * bq * q) / (2.0 * s[HV])
    dq = area * (ku * aq * a + kv * bq * b)
    return da, db, dq


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


@ti.func
def cell_blocks(x: ti.template(), s, share, blend, n, j, i, out: ti.template()):
    """Second derivatives by (a / (2 hu), b / (2 hv), q): blocks aa, ab, aq, bb, bq, qq into ``out`` [n, j, i, 6]."""
    area = s[HU] * s[HV]
    eye = identity()
    a, b, q = tangents(x, s, n, j, i)
    _, stress, moduli = material_response(material_strain(a, b, s), s)
    turn = rotation(s)
    t = blended_stress(turn.transpose() @ stress, blend)
    d = mat3([[moduli[0], 0.0, 0.0], [0.0, moduli[1], 0.0], [0.0, 0.0, moduli[2]]])
    c = turn.transpose() @ d @ turn
    ku, kv = share * s[K_WEFT] / (12.0 * s[HU] * s[HU]), share * s[K_WARP] / (12.0 * s[HV] * s[HV])
    aq, bq = blend * a.dot(q), blend * b.dot(q)
    p0, p2 = c[0, 0] * a + c[0, 2] * b, c[0, 2] * a + c[2, 2] * b
    w1, w2 = c[1, 1] * b + c[1, 2] * a, c[1, 2] * b + c[2, 2] * a
    aa = a.outer_product(p0) + b.outer_product(p2) + t[0] * eye + ku * q.outer_product(q)
    ab = a.outer_product(c[0, 1] * b + c[0, 2] * a) + b.outer_product(w2) + t[2] * eye
    bb = b.outer_product(w1) + a.outer_product(w2) + t[1] * eye + kv * q.outer_product(q)
    aq_block = ku * (q.outer_product(a) + aq * eye)
    bq_block = kv * (q.outer_product(b) + bq * eye)
    qq = ku * a.outer_product(a) + kv * b.outer_product(b)
    fu, fv = 1.0 / (2.0 * s[HU]), 1.0 / (2.0 * s[HV])
    out[n, j, i, 0] = area * fu * fu * aa
    out[n, j, i, 1] = area * fu * fv * ab
    out[n, j, i, 2] = area * fu * aq_block
    out[n, j, i, 3] = area * fv * fv * bb
    out[n, j, i, 4] = area * fv * bq_block
    out[n, j, i, 5] = area * qq
