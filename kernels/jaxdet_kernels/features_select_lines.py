"""The strongest corners of an edge map on the CPU, one after the other: a frame a thread.

The mask is asked only where the selection needs it. Corners above ``quality`` times the strongest
pixel anywhere pass whatever the mask is; only if they leave slots empty does the strongest allowed
pixel have to be known.

``SELECT`` is C++ for native functions: it calls ``allowed(x, y)``, before that ``expect(place)`` so
that memory can be fetched, and ``accept(slot, x, y)``, and leaves the number of corners in
``taken``, at most one more than the ``N`` slots.
"""

import warp as wp

from jaxdet_kernels.features_canny_lines import MAX_SIZE
from jaxdet_kernels.features_corners_lines import MEASURE, STRENGTH

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

SELECT = """
    const int want = N + 1;
    u64* list = (u64*)keys_out.data;
    u64* chosen = list + (size_t)H * W;
    u64* other = chosen + (size_t)H * W;
    wp::uint32* blocked = blocked_out.data;
    const int reach = distance >= 1.0 ? (int)__builtin_ceil(distance) - 1 : -1;
    const double nearest = distance * distance;
    int halves[MAX_SIZE];
    for (int dy = 0; dy <= reach && dy < H; ++dy) {
        int half = (int)__builtin_sqrt(nearest - (double)dy * dy);
        while (half >= 0 && (double)half * half + (double)dy * dy >= nearest) --half;
        while ((double)(half + 1) * (half + 1) + (double)dy * dy < nearest) ++half;
        halves[dy] = half < W ? half : W;
    }
    for (int i = 0; i < H * words * 2; ++i) blocked[i] = 0;
    auto share = [&](float strength) { return (float)((double)strength * quality); };
    auto value_of = [](u64 key) {
        const wp::uint32 bits = (wp::uint32)(key >> 32);
        float value;
        __builtin_memcpy(&value, &bits, 4);
        return value;
    };
    int count = 0, taken = 0;
    float first = 0.0f;
    // Lists the 3x3 maxima above a limit, by place.
    auto gather = [&](float limit) {
        count = 0;
        for (int y = 1; y < H - 1; ++y)
            for (int g = 0; g < groups; ++g)
                each(lives[y][g], g, [&](int x) {
                    const float* e = image_strength + (size_t)y * pitch + x;
                    const f16 v = *(const f16*)e;
                    i16 is = v > limit;
                    if (!__builtin_reduce_or(is)) return;
                    for (int k = -1; k < 2; ++k) {
                        const float* near = e + k * pitch;
                        is &= v >= *(const f16*)(near - 1);
                        is &= v >= *(const f16*)near;
                        is &= v >= *(const f16*)(near + 1);
                    }
                    const b16 packed = __builtin_convertvector(is, b16);
                    wp::uint16 left;
                    __builtin_memcpy(&left, &packed, 2);
                    for (; left; left &= left - 1) {
                        const int u = x + __builtin_ctz(left);
                        if (u < 1 || u > W - 2) continue;
                        wp::uint32 bits;
                        __builtin_memcpy(&bits, e - x + u, 4);
                        list[count++] = ((u64)bits << 32) | (wp::uint32)(y * W + u);
                    }
                });
    };
    // Rising by strength, ties by place, as the list is by place.
    auto sort = [&](int length) {
        wp::uint32 least = 0xffffffffu, greatest = 0;
        for (int i = 0; i < length; ++i) {
            const wp::uint32 bits = chosen[i] >> 32;
            least = bits < least ? bits : least;
            greatest = bits > greatest ? bits : greatest;
        }
        for (int shift = 0; shift < 32 && length && (greatest - least) >> shift; shift += 8) {
            int bins[257] = {};
            auto digit = [&](u64 key) {
                return (((wp::uint32)(key >> 32) - least) >> shift) & 255;
            };
            for (int i = 0; i < length; ++i) ++bins[digit(chosen[i]) + 1];
            for (int i = 1; i < 256; ++i) bins[i] += bins[i - 1];
            for (int i = 0; i < length; ++i) other[bins[digit(chosen[i])]++] = chosen[i];
            u64* swap = chosen; chosen = other; other = swap;
        }
    };
    auto choose = [&](float above, float up_to) {
        int length = 0;
        for (int i = 0; i < count; ++i) {
            const float value = value_of(list[i]);
            if (value > above && value <= up_to) chosen[length++] = list[i];
        }
        return length;
    };
    // Takes the listed corners in (above, up to], strongest first.
    auto take = [&](float above, float up_to) {
        const int length = choose(above, up_to);
        sort(length);
        for (int i = length - 1; i >= 0 && taken < want; --i) {
            const int place = (int)(wp::uint32)chosen[i], y = place / W, x = place - y * W;
            if (i >= 8) expect((int)(wp::uint32)chosen[i - 8]);
            if (blocked[y * words * 2 + x / 32] >> (x % 32) & 1) continue;
            if (!allowed(x, y)) continue;
            if (taken == 0) first = value_of(chosen[i]);
            if (taken < N) accept(taken, x, y);
            ++taken;
            for (int dy = -reach; dy <= reach; ++dy) {
                const int row = y + dy;
                if (row < 0 || row >= H) continue;
                const int half = halves[dy < 0 ? -dy : dy];
                const int from = x > half ? x - half : 0, to = x + half < W ? x + half : W - 1;
                wp::uint32* line = blocked + row * words * 2;
                for (int w = from / 32; w <= to / 32; ++w) {
                    wp::uint32 in = ~0u;
                    if (w == from / 32) in &= ~0u << from % 32;
                    if (w == to / 32) in &= ~0u >> (31 - to % 32);
                    line[w] |= in;
                }
            }
        }
    };
    const float top = measure(), sure = share(top), listed = share(0.5f * top);
    if (top > 0.0f) {
        gather(listed);
        take(sure, top);
    }
    // Below that a corner counts if it is above the share of the strongest allowed pixel. That is
    // at least the first corner's, so there may be none to ask for.
    const float least = share(first);
    if (top > 0.0f && taken < want && first < top && masked
        && (least < listed || choose(least, sure) > 0)) {
        // The strongest allowed pixel, where no maximum may be.
        float best = first;
        for (int y = 0; y < H; ++y)
            for (int g = 0; g < groups; ++g)
                each(lives[y][g], g, [&](int x) {
                    const float* e = image_strength + (size_t)y * pitch + x;
                    if (!__builtin_reduce_or(*(const f16*)e > best)) return;
                    for (int k = 0; k < 16; ++k)
                        if (e[k] > best && allowed(x + k, y)) best = e[k];
                });
        if (best > 0.0f) {
            if (share(best) < listed) gather(share(best));
            take(share(best), sure);
        }
    }
    clear();
""".replace("MAX_SIZE", str(MAX_SIZE))

_MASKED = """
    const int H = mask.shape[1], W = mask.shape[2], N = u_out.shape[1];
    const wp::uint32* edge_map = edges.data + (size_t)b * H * edges.shape[2];
    const unsigned char* may = (const unsigned char*)mask.data + (size_t)b * H * W;
    int* column = u_out.data + (size_t)b * N;
    int* row_of = v_out.data + (size_t)b * N;
    auto expect = [&](int place) { __builtin_prefetch(may + place); };
    auto allowed = [&](int x, int y) { return !masked || may[(size_t)y * W + x]; };
    auto accept = [&](int slot, int x, int y) { column[slot] = x; row_of[slot] = y; };
"""

_REST = """
    found_out.data[b] = taken;
    for (int i = taken; i < N; ++i) column[i] = row_of[i] = 0;
"""


@wp.func_native(f"#if !defined(__CUDA_ARCH__)\n{_MASKED}{STRENGTH}{MEASURE}{SELECT}{_REST}#endif\n")
def _corners(
    b: int,
    edges: wp.array3d[wp.uint32],
    mask: wp.array3d[wp.bool],
    masked: int,
    quality: wp.float64,
    distance: wp.float64,
    strength: wp.array2d[wp.float32],
    u_out: wp.array2d[wp.int32],
    v_out: wp.array2d[wp.int32],
    found_out: wp.array[wp.int32],
    keys_out: wp.array[wp.uint32],
    blocked_out: wp.array2d[wp.uint32],
): ...


@wp.kernel
def corners_lines(
    share: int,
    shares: int,
    edges: wp.array3d[wp.uint32],
    mask: wp.array3d[wp.bool],
    masked: int,
    quality: wp.float64,
    distance: wp.float64,
    strength: wp.array3d[wp.float32],
    u_out: wp.array2d[wp.int32],
    v_out: wp.array2d[wp.int32],
    found_out: wp.array[wp.int32],
    keys_out: wp.array2d[wp.uint32],
    blocked_out: wp.array3d[wp.uint32],
):
    """The corners of a frame a thread, ``share + shares * i``, strongest first.

    The last two outputs are scratch, a part for each share, and so is ``strength``
    ``(shares, H, 32 words + 32)``, which comes and goes with zeros.
    """
    b = share + shares * wp.tid()
    _corners(
        b, edges, mask, masked, quality, distance, strength[share], u_out, v_out, found_out,
        keys_out[share], blocked_out[share],
    )  # fmt: skip
