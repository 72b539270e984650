"""Stage align: depth pixels splatted into the colour image, the nearest wins.

Twin of ``jaxdet/reference/_align.py`` and ``_lens.py``, operation by operation. The module is
compiled without fused multiply-add, so that every operation is rounded on its own.

A key is ``depth << 16 | z`` (depth in the depth camera, z in the colour camera), so one unsigned
minimum decides on both, whatever the order of the writes. z stays below 65535, so that no key
equals the initial one, all bits set.
"""

import warp as wp

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

PINHOLE, PLUMB_BOB, RATIONAL, EQUIDISTANT = 0, 1, 2, 3
"""Lens models, by number."""

PARAMETERS = 26
"""Length of ``parameters``: rotation 0-8, translation 9-11, fx fy cx cy 12-15, lens 16-23,
largest squared slope 24, metres in a depth unit 25."""

Box = wp.types.vector(length=5, dtype=wp.int32)
"""Left, top, right, bottom, z."""


@wp.func
def align_arctangent(x: wp.float64):
    """Cephes ``atan`` for x >= 0 from the four operations alone."""
    one = wp.float64(1.0)
    t = x
    offset = wp.float64(0.0)
    if x > wp.float64(2.414213562373095):
        offset = wp.float64(1.5707963267948966)
        t = -one / x
    elif x > wp.float64(0.66):
        offset = wp.float64(0.7853981633974483)
        t = (x - one) / (x + one)
    z = t * t
    p = wp.float64(-8.750608600031904122785e-1)
    p = p * z + wp.float64(-1.615753718733365076637e1)
    p = p * z + wp.float64(-7.500855792314704667340e1)
    p = p * z + wp.float64(-1.228866684490136173410e2)
    p = p * z + wp.float64(-6.485021904942025371773e1)
    q = z + wp.float64(2.485846490142306297962e1)
    q = q * z + wp.float64(1.650270098316988542046e2)
    q = q * z + wp.float64(4.328810604912902668951e2)
    q = q * z + wp.float64(4.853903996359136964868e2)
    q = q * z + wp.float64(1.945506571482613964425e2)
    return offset + (t * (z * p / q) + t)


@wp.func
def align_equidistant(x: wp.float32, y: wp.float32, k: wp.array[wp.float32]):
    """Kannala-Brandt, in float64."""
    one = wp.float64(1.0)
    wx = wp.float64(x)
    wy = wp.float64(y)
    r = wp.sqrt(wx * wx + wy * wy)
    theta = align_arctangent(r)
    t2 = theta * theta
    series = wp.float64(k[18]) + t2 * wp.float64(k[19])
    series = one + t2 * (wp.float64(k[16]) + t2 * (wp.float64(k[17]) + t2 * series))
    scale = one
    if r > wp.float64(1.0e-9):
        scale = (theta * series) / r
    return wp.vec2(wp.float32(wx * scale), wp.float32(wy * scale))


@wp.func
def align_brown_conrady(
    x: wp.float32, y: wp.float32, r2: wp.float32, k: wp.array[wp.float32], rational: bool
):
    """OpenCV's radial and tangential model."""
    one = wp.float32(1.0)
    two = wp.float32(2.0)
    radial = one + r2 * (k[16] + r2 * (k[17] + r2 * k[20]))
    if rational:
        radial = radial / (one + r2 * (k[21] + r2 * (k[22] + r2 * k[23])))
    xy = two * (x * y)
    dx = x * radial + (k[18] * xy + k[19] * (r2 + two * (x * x)))
    dy = y * radial + (k[19] * xy + k[18] * (r2 + two * (y * y)))
    return wp.vec2(dx, dy)


@wp.func
def align_project(
    units: wp.uint16, x: wp.float32, y: wp.float32, p: wp.array[wp.float32], model: int
):
    """Colour column, row and z of a ray at a depth; z = -1 where it can't be seen."""
    depth = wp.float32(units) * p[25]
    px = depth * x
    py = depth * y
    cx = p[0] * px + (p[1] * py + (p[2] * depth + p[9]))
    cy = p[3] * px + (p[4] * py + (p[5] * depth + p[10]))
    cz = p[6] * px + (p[7] * py + (p[8] * depth + p[11]))
    if not cz > wp.float32(0.0):
        return wp.vec3i(0, 0, -1)
    px = cx / cz
    py = cy / cz
    r2 = px * px + py * py
    if not r2 <= p[24]:
        return wp.vec3i(0, 0, -1)
    if model == 3:
        bent = align_equidistant(px, py, p)
        px = bent[0]
        py = bent[1]
    elif model != 0:
        bent = align_brown_conrady(px, py, r2, p, model == 2)
        px = bent[0]
        py = bent[1]
    half = wp.float32(0.5)
    column = px * p[12] + p[14] + half
    row = py * p[13] + p[15] + half
    limit = wp.float32(1048576.0)
    if not (wp.abs(column) < limit and wp.abs(row) < limit):
        return wp.vec3i(0, 0, -1)
    z = wp.min(cz / p[25] + half, wp.float32(65534.0))
    return wp.vec3i(int(column), int(row), int(z))


@wp.func
def align_rectangle(
    units: wp.uint16,
    v: int,
    u: int,
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    p: wp.array[wp.float32],
    model: int,
    fills: int,
    height: int,
    width: int,
):
    """The colour pixels that a depth pixel covers, clipped: left, top, right, bottom, z.

    Empty (right < left) where the pixel is not seen.
    """
    none = Box(0, 0, -1, -1, 0)
    first = align_project(units, corner_x[v, u], corner_y[v, u], p, model)
    if first[2] < 0:
        return none
    last = first
    if fills != 0:
        last = align_project(units, corner_x[v + 1, u + 1], corner_y[v + 1, u + 1], p, model)
        if last[2] < 0:
            return none
    return Box(
        wp.max(first[0], 0),
        wp.max(first[1], 0),
        wp.min(last[0], width - 1),
        wp.min(last[1], height - 1),
        first[2],
    )


@wp.kernel
def align_splat(
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    model: int,
    fills: int,
    keys_out: wp.array3d[wp.uint32],
):
    """A thread a depth pixel, atomic minimum; for CUDA."""
    b, v, u = wp.tid()
    units = depth[b, v, u]
    if units == wp.uint16(0):
        return
    box = align_rectangle(
        units, v, u, corner_x, corner_y, parameters, model, fills,
        keys_out.shape[1], keys_out.shape[2],
    )  # fmt: skip
    key = (wp.uint32(units) << wp.uint32(16)) | wp.uint32(box[4])
    for row in range(box[1], box[3] + 1):
        for column in range(box[0], box[2] + 1):
            wp.atomic_min(keys_out, b, row, column, key)


@wp.kernel
def align_splat_rows(
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    model: int,
    fills: int,
    keys_out: wp.array3d[wp.uint32],
):
    """A thread a depth row without atomics; for the CPU, where Warp runs threads one by one."""
    b, v = wp.tid()
    for u in range(depth.shape[2]):
        units = depth[b, v, u]
        if units != wp.uint16(0):
            box = align_rectangle(
                units, v, u, corner_x, corner_y, parameters, model, fills,
                keys_out.shape[1], keys_out.shape[2],
            )  # fmt: skip
            key = (wp.uint32(units) << wp.uint32(16)) | wp.uint32(box[4])
            for row in range(box[1], box[3] + 1):
                for column in range(box[0], box[2] + 1):
                    if key < keys_out[b, row, column]:
                        keys_out[b, row, column] = key
