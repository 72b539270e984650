"""Views of the simulator: camera rays cast on triangle meshes, texture, light and shadow.

A view is a camera at a pose in a world; views of one world or of several are rendered in one
launch. The triangle that a ray hits is found in float32 by Warp's bounding volume hierarchy; the
depth is then computed in float64 from the triangle's plane, so it is exact up to rounding.

The triangles of all worlds are concatenated; those of world ``w`` begin at ``first[w]``. A row of
``looks`` (surface appearance) is: pattern 0, colour 1-3, accent 4-6, period 7, grain 8, gloss 9,
offset of the pattern 10-11. A row of ``lamps`` is: direction to the lamp 0-2, radius of the lamp's
disc at unit distance 3.
"""

import warp as wp

from jaxdet_kernels.build import CPU_FLAGS

wp.set_module_options({"fuse_fp": False, "enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})

FAR = 200.0
"""Maximum range of rays [m]."""
SIZE = wp.constant(512)
"""Side of the finest level of a texture [texel]."""
LEVELS = wp.constant(8)
"""Number of mipmap levels of a texture, each half as wide as the one before."""
PERIODS = wp.constant(4.0)
"""Number of periods of the pattern per texture."""


@wp.func
def raycast_texel(patterns: wp.array2d[wp.vec3], row: int, level: int, s: float, t: float):
    """Look up a texel bilinearly in one mipmap level; ``s t`` in units of the complete image."""
    n = SIZE >> level
    start = (SIZE * SIZE - n * n) * 4 // 3
    x = (s - wp.floor(s)) * float(n) - 0.5
    y = (t - wp.floor(t)) * float(n) - 0.5
    x0 = int(wp.floor(x))
    y0 = int(wp.floor(y))
    ax = x - float(x0)
    ay = y - float(y0)
    x1 = (x0 + 1) % n
    y1 = (y0 + 1) % n
    x0 = (x0 + n) % n
    y0 = (y0 + n) % n
    top = patterns[row, start + y0 * n + x0] * (1.0 - ax) + patterns[row, start + y0 * n + x1] * ax
    low = patterns[row, start + y1 * n + x0] * (1.0 - ax) + patterns[row, start + y1 * n + x1] * ax
    return top * (1.0 - ay) + low * ay


@wp.func
def raycast_texture(
    patterns: wp.array2d[wp.vec3],
    looks: wp.array2d[wp.float32],
    look: int,
    st: wp.vec2,
    pixel: float,
):
    """Return the colour of a point on a surface [grey levels]; ``pixel`` is its footprint [m]."""
    span = PERIODS * looks[look, 7]
    s = st[0] / span + looks[look, 10]
    t = st[1] / span + looks[look, 11]
    level = wp.clamp(wp.log2(pixel * float(SIZE) / span), 0.0, float(LEVELS - 1))
    first = wp.min(int(level), LEVELS - 2)
    blend = level - float(first)
    row = int(looks[look, 0])
    mix = raycast_texel(patterns, row, first, s, t) * (1.0 - blend)
    mix = mix + raycast_texel(patterns, row, first + 1, s, t) * blend
    color = wp.vec3(looks[look, 1], looks[look, 2], looks[look, 3])
    accent = wp.vec3(looks[look, 4], looks[look, 5], looks[look, 6])
    shade = mix[1] + looks[look, 8] * mix[2]
    return color + (accent - color) * mix[0] + wp.vec3(shade, shade, shade)


@wp.func
def raycast_lamp(mesh: wp.uint64, lamp: wp.vec3, radius: float, samples: int, point: wp.vec3):
    """Return the fraction of the lamp's disc that is visible from a point."""
    side = wp.normalize(wp.cross(lamp, wp.vec3(0.31, 0.87, -0.38)))
    other = wp.cross(lamp, side)
    lit = wp.float32(0.0)
    for i in range(samples):
        angle = 2.3999632 * float(i)
        reach = radius * wp.sqrt((float(i) + 0.5) / float(samples))
        way = lamp + side * (reach * wp.cos(angle)) + other * (reach * wp.sin(angle))
        if not wp.mesh_query_ray_anyhit(mesh, point, way, FAR):
            lit += 1.0
    return lit / float(samples)


@wp.func
def raycast_light(
    mesh: wp.uint64,
    lamps: wp.array2d[wp.float32],
    b: int,
    samples: int,
    point: wp.vec3,
    flat: wp.vec3,
    normal: wp.vec3,
    eye: wp.vec3,
    gloss: float,
):
    """Return diffuse (Lambert, times the lamp's visible fraction) and specular light (Blinn)."""
    lamp = wp.vec3(lamps[b, 0], lamps[b, 1], lamps[b, 2])
    cosine = wp.dot(normal, lamp)
    if cosine <= 0.0 or wp.dot(flat, lamp) <= 0.0:
        return wp.vec2(0.0, 0.0)
    seen = raycast_lamp(mesh, lamp, lamps[b, 3], samples, point)
    half = wp.max(wp.dot(normal, wp.normalize(lamp + eye)), 0.0)
    return wp.vec2(cosine * seen, seen * gloss * wp.pow(half, 60.0))


@wp.func
def raycast_ray(
    poses: wp.array2d[wp.float64], pinholes: wp.array2d[wp.float64], b: int, v: int, u: int
):
    """Return the direction of a pixel's ray in the world, with length 1 along the optical axis."""
    x = (wp.float64(u) - pinholes[b, 2]) / pinholes[b, 0]
    y = (wp.float64(v) - pinholes[b, 3]) / pinholes[b, 1]
    return wp.vec3d(
        poses[b, 0] * x + poses[b, 1] * y + poses[b, 2],
        poses[b, 4] * x + poses[b, 5] * y + poses[b, 6],
        poses[b, 8] * x + poses[b, 9] * y + poses[b, 10],
    )


@wp.kernel
def raycast_view(
    meshes: wp.array[wp.uint64],
    first: wp.array[wp.int32],
    planes: wp.array2d[wp.float64],
    normals: wp.array2d[wp.vec3],
    places: wp.array2d[wp.vec2],
    look_of: wp.array[wp.int32],
    looks: wp.array2d[wp.float32],
    patterns: wp.array2d[wp.vec3],
    world_of: wp.array[wp.int32],
    poses: wp.array2d[wp.float64],
    pinholes: wp.array2d[wp.float64],
    lamps: wp.array2d[wp.float32],
    samples: int,
    face_out: wp.array3d[wp.int32],
    depth_out: wp.array3d[wp.float64],
    color_out: wp.array3d[wp.vec3],
    light_out: wp.array3d[wp.vec3],
):
    """Render views, one thread per pixel.

    ``face_out`` is the triangle (-1: none), ``depth_out`` z in the camera (inf: none) [m],
    ``color_out`` the colour of the surface [grey levels]; ``light_out`` is diffuse light, specular
    light, and the cosine of the angle between normal and view.
    """
    b, v, u = wp.tid()
    world = world_of[b]
    way = raycast_ray(poses, pinholes, b, v, u)
    ray = wp.vec3(float(way[0]), float(way[1]), float(way[2]))
    origin = wp.vec3(float(poses[b, 3]), float(poses[b, 7]), float(poses[b, 11]))
    hit = wp.mesh_query_ray(meshes[world], origin, ray, FAR)
    face_out[b, v, u] = -1
    depth_out[b, v, u] = wp.float64(wp.inf)
    color_out[b, v, u] = wp.vec3(0.0, 0.0, 0.0)
    light_out[b, v, u] = wp.vec3(0.0, 0.0, 0.0)
    if not hit.result:
        return
    face = hit.face + first[world]
    face_out[b, v, u] = face
    n = wp.vec3d(planes[face, 0], planes[face, 1], planes[face, 2])
    start = wp.vec3d(poses[b, 3], poses[b, 7], poses[b, 11])
    depth = (planes[face, 3] - wp.dot(n, start)) / wp.dot(n, way)
    depth_out[b, v, u] = depth
    a = hit.u
    c = hit.v
    rest = 1.0 - a - c
    normal = wp.normalize(normals[face, 0] * a + normals[face, 1] * c + normals[face, 2] * rest)
    flat = wp.vec3(float(n[0]), float(n[1]), float(n[2]))
    if wp.dot(flat, ray) > 0.0:
        flat = -flat
        normal = -normal
    eye = -wp.normalize(ray)
    facing = wp.max(wp.dot(normal, eye), 0.02)
    st = places[face, 0] * a + places[face, 1] * c + places[face, 2] * rest
    # The footprint of a pixel grows on slanted surfaces; the root is a compromise between its two
    # widths.
    pixel = float(depth / pinholes[b, 0]) / wp.sqrt(facing)
    look = look_of[face]
    color_out[b, v, u] = raycast_texture(patterns, looks, look, st, pixel)
    point = origin + ray * float(depth) + flat * 2.0e-4
    lit = wp.vec2(0.0, 0.0)
    if samples > 0:
        lit = raycast_light(
            meshes[world], lamps, b, samples, point, flat, normal, eye, looks[look, 9]
        )
    light_out[b, v, u] = wp.vec3(lit[0], lit[1], facing)
