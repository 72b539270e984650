"""Shi-Tomasi strengths of an edge map on the CPU, to the bit of ``jaxdet/reference/_corners.py``.

C++ that ``features_select_lines`` is made of. Rows run through rings; the running sums in float64
follow OpenCV's box filter row by row. Blocks of 16 columns without an edge near are skipped: adding
and taking away zeros changes nothing there, and no pixel there is a corner. The sums are not quite
zero, but their strength is never positive: squares of gradients are whole multiples of 2^-31 or
else below 2^-66, too small to change the sum of any others, so they can only be missing in the end.
"""

from jaxdet_kernels.features_canny_lines import MAX_SIZE

STRENGTH = """
    typedef unsigned long long u64;
    typedef float f16 __attribute__((ext_vector_type(16), aligned(4)));
    typedef double d16 __attribute__((ext_vector_type(16), aligned(8)));
    typedef int i16 __attribute__((ext_vector_type(16)));
    typedef bool b16 __attribute__((ext_vector_type(16)));
    const int words = edges.shape[2] / 2, groups = (words + 15) / 16;
    const int MOST_GROUPS = MAX_SIZE / 1024, RING = MAX_SIZE + 32;
    const u64* map = (const u64*)edge_map;
    const double scale = 1.0 / (4.0 * 3.0 * 255.0);
    const double k1 = (float)scale, k0 = (float)(2.0 * scale);
    // Three neighbours in a row, smoothed: 8 values, by their bits from left to right.
    float smooth[8];
    for (int i = 0; i < 8; ++i) {
        const double p = i & 1 ? 255.0 : 0.0, q = i & 2 ? 255.0 : 0.0, r = i & 4 ? 255.0 : 0.0;
        smooth[i] = (float)(r * k1 + (double)(float)(q * k0 + (double)(float)(p * k1)));
    }
    const float middle = (float)(255.0 * k0);
    // Column x is at x + 16. Rows of edges, smoothed and differences; products; their sums.
    float smooths[3][RING], steps[3][RING], products[3][RING];
    double sums[3][3][RING], totals[3][RING];
    u64 near_edge[3][MOST_GROUPS], lively[3][MOST_GROUPS], produced[MOST_GROUPS];
    auto mirrored = [&](int y) { return y < 0 ? -y : (y >= H ? 2 * H - 2 - y : y); };
    auto pick = [](wp::uint32 word, f16 yes, f16 no) {
        const wp::uint16 low = (wp::uint16)word;
        b16 mask;
        __builtin_memcpy(&mask, &low, 2);
        return __builtin_convertvector(mask, i16) != 0 ? yes : no;
    };
    // Calls use(x) for the first column of each block in these bits.
    auto each = [](u64 blocks, int group, auto use) {
        for (; blocks; blocks &= blocks - 1) use((group * 64 + __builtin_ctzll(blocks)) * 16);
    };
    // Reads row y into slot s.
    auto read = [&](int y, int s) {
        const u64* row = map + (size_t)y * words;
        u64 found[MOST_GROUPS] = {};
        for (int w = 0; w < words; ++w) {
            const u64 left = w > 0 ? row[w - 1] : 0, right = w + 1 < words ? row[w + 1] : 0;
            if (!(row[w] | (left >> 62) | (right & 3))) continue;
            u64 t = row[w] | (row[w] << 1) | (row[w] >> 1) | (row[w] << 2) | (row[w] >> 2);
            t |= (left >> 62) | (left >> 63) | (right << 62) | (right << 63);
            for (int k = 0; k < 4; ++k)
                if (t & (0xffffull << 16 * k)) found[w / 16] |= 1ull << (w % 16 * 4 + k);
        }
        for (int g = 0; g < groups; ++g) {
            each(near_edge[s][g] & ~found[g], g, [&](int x) {
                *(f16*)(smooths[s] + 16 + x) = *(f16*)(steps[s] + 16 + x) = (f16)0.0f;
            });
            near_edge[s][g] = found[g];
            each(found[g], g, [&](int x) {
                const int w = x >> 6, shift = x & 63;
                // Bits of columns x - 1 to x + 16, mirrored at the image's border.
                u64 bits = row[w] >> shift << 1;
                bits |= shift ? row[w] >> (shift - 1) & 1 : (w ? row[w - 1] >> 63 : 0);
                if (shift == 48) bits |= (w + 1 < words ? row[w + 1] & 1 : 0) << 17;
                if (x == 0) bits |= bits >> 2 & 1;
                if (W - x <= 16 && W - x > 0) bits |= (bits >> (W - x - 1) & 1) << (W - x + 1);
                const f16 low0 = pick(bits, smooth[1], smooth[0]);
                const f16 low1 = pick(bits, smooth[3], smooth[2]);
                const f16 high0 = pick(bits, smooth[5], smooth[4]);
                const f16 high1 = pick(bits, smooth[7], smooth[6]);
                const f16 low = pick(bits >> 1, low1, low0), high = pick(bits >> 1, high1, high0);
                *(f16*)(smooths[s] + 16 + x) = pick(bits >> 2, high, low);
                *(f16*)(steps[s] + 16 + x) =
                    pick(bits >> 2, 1.0f, 0.0f) - pick(bits, 1.0f, 0.0f);
            });
        }
    };
    // The sums over three columns of the products in a row whose neighbours are in these slots.
    auto produce = [&](int above, int own, int below, int s) {
        for (int g = 0; g < groups; ++g) {
            const u64 live = near_edge[above][g] | near_edge[own][g] | near_edge[below][g];
            each(produced[g] & ~live, g, [&](int x) {
                for (int q = 0; q < 3; ++q) *(f16*)(products[q] + 16 + x) = (f16)0.0f;
            });
            each(lively[s][g] & ~live, g, [&](int x) {
                for (int q = 0; q < 3; ++q) *(d16*)(sums[s][q] + 16 + x) = (d16)0.0;
            });
            produced[g] = lively[s][g] = live;
            each(live, g, [&](int x) {
                const int i = 16 + x;
                const f16 outer = *(f16*)(steps[above] + i) + *(f16*)(steps[below] + i);
                const f16 center = *(f16*)(steps[own] + i) * middle;
                const f16 dx = __builtin_convertvector(
                    __builtin_convertvector(outer, d16) * (255.0 * k1)
                    + __builtin_convertvector(center, d16), f16);
                const f16 dy = *(f16*)(smooths[below] + i) - *(f16*)(smooths[above] + i);
                *(f16*)(products[0] + i) = dx * dx;
                *(f16*)(products[1] + i) = dx * dy;
                *(f16*)(products[2] + i) = dy * dy;
            });
        }
        for (int q = 0; q < 3; ++q) {
            products[q][15] = products[q][17];
            products[q][16 + W] = products[q][14 + W];
            for (int g = 0; g < groups; ++g)
                each(produced[g], g, [&](int x) {
                    const float* p = products[q] + 16 + x;
                    const d16 left = __builtin_convertvector(*(f16*)(p - 1), d16);
                    const d16 own = __builtin_convertvector(*(f16*)p, d16);
                    const d16 right = __builtin_convertvector(*(f16*)(p + 1), d16);
                    *(d16*)(sums[s][q] + 16 + x) = (left + own) + right;
                });
        }
    };
""".replace("MAX_SIZE", str(MAX_SIZE))

MEASURE = """
    // Strengths of the whole frame; 0 where there is no edge near. Which blocks are not, by row.
    const int pitch = strength.shape[1];
    float* image_strength = strength.data + 16;
    u64 lives[MAX_SIZE][MOST_GROUPS];
    auto measure = [&]() -> float {
        const int size = words * 64 + 32;
        for (int s = 0; s < 3; ++s)
            for (int i = 0; i < size; ++i) {
                smooths[s][i] = steps[s][i] = products[s][i] = 0.0f;
                for (int q = 0; q < 3; ++q) sums[s][q][i] = 0.0;
            }
        for (int g = 0; g < groups; ++g) {
            produced[g] = 0;
            for (int s = 0; s < 3; ++s) near_edge[s][g] = lively[s][g] = 0;
        }
        for (int y = 0; y < 3; ++y) read(y, y);
        produce(0, 1, 2, 2);  // row -1 is row 1
        produce(1, 0, 1, 0);
        for (int q = 0; q < 3; ++q)
            for (int i = 0; i < size; ++i) totals[q][i] = sums[2][q][i] + sums[0][q][i];
        f16 peak = (f16)0.0f;
        for (int y = 0; y < H; ++y) {
            const int next = (y + 1) % 3, oldest = (y + 2) % 3;
            if (y + 1 == H) {
                read(H - 3, H % 3);
                produce(H % 3, (H - 2) % 3, (H - 1) % 3, next);  // row H is row H - 2
            } else {
                if (y > 0) read(mirrored(y + 2), (y + 2) % 3);
                produce(y % 3, next, (y + 2) % 3, next);
            }
            float* row = image_strength + (size_t)y * pitch;
            for (int g = 0; g < groups; ++g) {
                lives[y][g] = lively[0][g] | lively[1][g] | lively[2][g];
                each(lives[y][g], g, [&](int x) {
                    const int i = 16 + x;
                    f16 sum[3];
                    for (int q = 0; q < 3; ++q) {
                        const d16 total = *(d16*)(totals[q] + i) + *(d16*)(sums[next][q] + i);
                        sum[q] = __builtin_convertvector(total, f16);
                        *(d16*)(totals[q] + i) = total - *(d16*)(sums[oldest][q] + i);
                    }
                    const f16 a = 0.5f * sum[0], c = 0.5f * sum[2], t = a - c;
                    const f16 root = __builtin_elementwise_sqrt(t * t + sum[1] * sum[1]);
                    f16 e = (a + c) - root;
                    if (W - x < 16) e = pick((1u << (W - x > 0 ? W - x : 0)) - 1, e, 0.0f);
                    *(f16*)(row + x) = e;
                    peak = e > peak ? e : peak;
                });
            }
        }
        return __builtin_reduce_max(peak);
    };
    // Leaves the image as it was found.
    auto clear = [&]() {
        for (int y = 0; y < H; ++y)
            for (int g = 0; g < groups; ++g)
                each(lives[y][g], g, [&](int x) {
                    *(f16*)(image_strength + (size_t)y * pitch + x) = (f16)0.0f;
                });
    };
""".replace("MAX_SIZE", str(MAX_SIZE))
