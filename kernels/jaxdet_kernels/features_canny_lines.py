"""Canny edges on the CPU, to the bit of ``jaxdet/reference/_canny.py``: a frame a thread.

All of it is in vectors of 16-bit integers on a few rows at a time, so a frame's images are read
once and nothing but bits is written. Edge maps are laid out as in ``features_canny``.
"""

import warp as wp

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

MAX_SIZE = 4096
"""Most columns and rows of a colour image."""

_SUPPRESS = """
#if !defined(__CUDA_ARCH__)
    typedef short lane __attribute__((ext_vector_type(32), aligned(2)));
    typedef bool flag __attribute__((ext_vector_type(32)));
    const int H = color.shape[1], W = color.shape[2], words = candidates_out.shape[1];
    const unsigned char* rgb = color.data + (size_t)b * H * W * 3;
    // Rings of rows; column x is at x + 32, and what is outside the image is at both ends.
    const int RING = MAX_SIZE + 128;
    short greys[3][RING], magnitudes[3][RING], across[2][RING], down[2][RING];
    for (int i = 0; i < RING; ++i) magnitudes[0][i] = magnitudes[1][i] = magnitudes[2][i] = 0;
    auto load = [&](int y) {
        const unsigned char* __restrict__ from = rgb + (size_t)y * W * 3;
        short* __restrict__ row = greys[y % 3] + 32;
        for (int x = 0; x < W; ++x)
            row[x] = (9798 * from[3 * x] + 19235 * from[3 * x + 1] + 3735 * from[3 * x + 2]
                + 16384) >> 15;
        row[-1] = row[0];
        row[W] = row[W - 1];
    };
    auto at = [](const short* row, int x) { return *(const lane*)(row + x); };
    auto bits = [](auto condition) {
        const flag packed = __builtin_convertvector(condition, flag);
        wp::uint32 word;
        __builtin_memcpy(&word, &packed, 4);
        return word;
    };
    load(0);
    for (int y = 0; y <= H; ++y) {
        short* m = magnitudes[y % 3] + 32;
        if (y < H) {
            if (y + 1 < H) load(y + 1);
            const short* a = greys[(y > 0 ? y - 1 : 0) % 3] + 32;
            const short* g = greys[y % 3] + 32;
            const short* c = greys[(y + 1 < H ? y + 1 : y) % 3] + 32;
            short* dx = across[y % 2] + 32;
            short* dy = down[y % 2] + 32;
            for (int x = 0; x < W; x += 32) {
                const lane al = at(a, x - 1), ar = at(a, x + 1), cl = at(c, x - 1);
                const lane cr = at(c, x + 1), gl = at(g, x - 1), gr = at(g, x + 1);
                const lane h = (ar - al) + (cr - cl) + (gr - gl) * (short)2;
                const lane v = (cl - al) + (cr - ar) + (at(c, x) - at(a, x)) * (short)2;
                *(lane*)(dx + x) = h;
                *(lane*)(dy + x) = v;
                *(lane*)(m + x) = __builtin_elementwise_abs(h) + __builtin_elementwise_abs(v);
            }
            for (int x = W; x < words * 32 + 1; ++x) m[x] = 0;
        } else {
            for (int x = 0; x < words * 32 + 1; ++x) m[x] = 0;
        }
        if (y == 0) continue;
        const short* up = magnitudes[(y + 1) % 3] + 32;  // the row before the last
        const short* own = magnitudes[(y + 2) % 3] + 32;
        const short* dx = across[(y + 1) % 2] + 32;
        const short* dy = down[(y + 1) % 2] + 32;
        wp::uint32* weak = candidates_out.data + (size_t)(y - 1) * words;
        wp::uint32* strong = strong_out.data + (size_t)(y - 1) * words;
        for (int w = 0; w < words; ++w) {
            const int x = w * 32;
            const lane here = at(own, x);
            wp::uint32 keep = bits(here > (lane)(short)low);
            if (keep) {
                const lane h = at(dx, x), v = at(dy, x);
                const lane ax = __builtin_elementwise_abs(h), ay = __builtin_elementwise_abs(v);
                // floor(ax tan 22.5) with 15 bits, as the products of 16-bit lanes give it.
                typedef int wide __attribute__((ext_vector_type(32)));
                const wide product = __builtin_convertvector(ax, wide) * 27146;
                const lane tan22 = __builtin_convertvector(product >> 16, lane);
                const wp::uint32 flat = bits(ay <= tan22) & bits(ax != (lane)(short)0);
                const wp::uint32 steep = bits(ay > tan22 + ax * (short)2);
                const wp::uint32 rising = bits((h ^ v) < (lane)(short)0);
                const lane l = at(own, x - 1), r = at(own, x + 1), t = at(up, x), u = at(m, x);
                const wp::uint32 horizontal = bits(here > l) & bits(here >= r);
                const wp::uint32 vertical = bits(here > t) & bits(here >= u);
                const wp::uint32 fall = bits(here > at(up, x - 1)) & bits(here > at(m, x + 1));
                const wp::uint32 rise = bits(here > at(up, x + 1)) & bits(here > at(m, x - 1));
                const wp::uint32 diagonal = (rising & rise) | (~rising & fall);
                keep &= (flat & horizontal) | (steep & vertical) | (~(flat | steep) & diagonal);
                if (W - x < 32) keep &= W - x > 0 ? (1u << (W - x)) - 1 : 0u;
            }
            weak[w] = keep;
            strong[w] = keep ? keep & bits(here > (lane)(short)high) : 0u;
        }
    }
#endif
""".replace("MAX_SIZE", str(MAX_SIZE))

_HYSTERESIS = """
#if !defined(__CUDA_ARCH__)
    typedef unsigned long long u64;
    const int H = candidates.shape[0], n = candidates.shape[1] / 2;
    const u64* allowed = (const u64*)candidates.data;
    const u64* seeds = (const u64*)strong.data;
    u64* reached = (u64*)edges_out.data + (size_t)b * H * n;
    // Fills the runs of allowed pixels in a row that hold a reached one.
    auto fill = [&](int y) {
        const u64* c = allowed + (size_t)y * n;
        u64* r = reached + (size_t)y * n;
        u64 carry = 0;
        for (int w = 0; w < n; ++w) {
            u64 now = r[w] | (carry & c[w]);
            // A seed added to its run of ones carries to the run's end.
            if (now && (c[w] & ~now)) now |= c[w] & ~(c[w] + now);
            r[w] = now;
            carry = now >> 63;
        }
        carry = 0;
        for (int w = n - 1; w >= 0; --w) {
            u64 now = r[w] | ((carry << 63) & c[w]);
            if (now && (c[w] & ~now)) {
                u64 run = c[w];
                for (int step = 1; step < 64; step *= 2) {
                    now |= run & (now >> step);
                    run &= run >> step;
                }
            }
            r[w] = now;
            carry = now & 1;
        }
    };
    // What a row reaches in the next one.
    auto spread = [&](int from, int y) {
        const u64* f = reached + (size_t)from * n;
        const u64* c = allowed + (size_t)y * n;
        u64* r = reached + (size_t)y * n;
        u64 any = 0;
        for (int w = 0; w < n; ++w) {
            u64 near = f[w] | (f[w] << 1) | (f[w] >> 1);
            if (w > 0) near |= f[w - 1] >> 63;
            if (w + 1 < n) near |= f[w + 1] << 63;
            const u64 fresh = near & c[w] & ~r[w];
            r[w] |= fresh;
            any |= fresh;
        }
        return any != 0;
    };
    for (int i = 0; i < H * n; ++i) reached[i] = seeds[i];
    for (int y = 0; y < H; ++y) fill(y);
    // Rows that have not told the next one, below and above, what they reach.
    unsigned char tells[2][MAX_SIZE];
    for (int y = 0; y < H; ++y) tells[0][y] = tells[1][y] = 1;
    for (bool told = true; told;) {
        told = false;
        for (int up = 0; up < 2; ++up)
            for (int k = 0; k + 1 < H; ++k) {
                const int from = up ? H - 1 - k : k, y = up ? from - 1 : from + 1;
                if (!tells[up][from]) continue;
                tells[up][from] = 0;
                if (!spread(from, y)) continue;
                fill(y);
                tells[0][y] = tells[1][y] = 1;
                told = true;
            }
    }
#endif
""".replace("MAX_SIZE", str(MAX_SIZE))


@wp.func_native(_SUPPRESS)
def canny_suppress_lines(
    b: int,
    color: wp.array4d[wp.uint8],
    low: int,
    high: int,
    candidates_out: wp.array2d[wp.uint32],
    strong_out: wp.array2d[wp.uint32],
):
    """Grey, Sobel and suppression of frame b into rows of bits; the bounds are from -1 to 2047."""


@wp.func_native(_HYSTERESIS)
def canny_hysteresis_lines(
    b: int,
    candidates: wp.array2d[wp.uint32],
    strong: wp.array2d[wp.uint32],
    edges_out: wp.array3d[wp.uint32],
):
    """Candidates reachable from strong ones, as frame b of the edges."""


@wp.kernel
def canny_lines(
    share: int,
    shares: int,
    color: wp.array4d[wp.uint8],
    low: int,
    high: int,
    edges_out: wp.array3d[wp.uint32],
    candidates_out: wp.array3d[wp.uint32],
    strong_out: wp.array3d[wp.uint32],
):
    """The edges of a frame a thread, ``share + shares * i``.

    The last two outputs are scratch, a part for each share.
    """
    b = share + shares * wp.tid()
    canny_suppress_lines(b, color, low, high, candidates_out[share], strong_out[share])
    canny_hysteresis_lines(b, candidates_out[share], strong_out[share], edges_out)
