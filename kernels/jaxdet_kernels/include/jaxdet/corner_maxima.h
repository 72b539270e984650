// Local maxima of the corner strength of an edge image, where a mask allows them. Twin of
// `strongest_corners` in jaxdet/reference/_corners.py, but for the minimum distance: see
// corner_selection.h. Strengths are worked out near allowed pixels only; no image of them is made.
//
// A strength is known as an interval first, see corner_strength.h, and exactly where that decides.
#pragma once
#include "corner_strength.h"
#include "vectors.h"

namespace jaxdet { namespace {

#if !defined(__CUDA_ARCH__)
// A frame on the CPU, row by row, in vectors. A vector has 16 columns: a block of 12, and two more at
// both sides, so that strengths and whether they are maxima need nothing of other blocks.
struct CornerMaxima {
    typedef unsigned long long Word;
    typedef Vectors::Floats Floats;
    typedef Vectors::Ints Ints;
    typedef Vectors::Unsigned Unsigned;
    enum {
        MAX_SIZE = 4096,
        LANES = Vectors::FLOATS, SIDE = 2, BLOCK = LANES - 2 * SIDE, ALL = (1 << BLOCK) - 1,
        BLOCKS = MAX_SIZE / BLOCK + 1,
        WORDS = MAX_SIZE / 64 + 2,       // With one at both sides of a row.
        RING = 5,                        // Rows of edges that are kept.
        EXACT = 4,                       // Rows whose exact sums are kept.
    };

    const unsigned* edges;    // (height, PixelBits::words(width))
    const unsigned* allowed;  // Likewise.
    Word everywhere;          // All ones: the mask is not asked.
    int height, width;
    double quality;           // Share of the strongest allowed strength that a corner exceeds.
    Word* list_out;           // (height * width), strength << 32 | place, by place.

    // What is known of some rows; row y is at y % 3.
    struct Rows {
        int sums[3][3][BLOCKS * LANES];    // Of xx, xy and yy over three columns, of a block's.
        bool summed[3][BLOCKS];            // The blocks that have them.
        // The strengths' intervals, of a block and of a column beside it; 0 where nothing is near.
        float most[3][BLOCKS * LANES], least[3][BLOCKS * LANES];
        int list[3][BLOCKS], count[3];     // The blocks that have strengths.
        // Rows of bits, word w at w + 1: edges, mirrored beside the image, row y at y % RING; where
        // those left and right differ; the mask; and where there are strengths.
        Word edge[RING][WORDS], sides[RING][WORDS], mask[3][WORDS], none[WORDS], here[WORDS];
        // Where dx and dy may not be 0, and the mask, each a pixel wider left and right.
        Word across[3][WORDS], along[3][WORDS], wide[3][WORDS];
        CornerColumn::State exact[MAX_SIZE];
        float exact_sums[EXACT][MAX_SIZE]; // The last of each column's, row y at y % EXACT.
    };

    int words() const { return PixelBits::words(width) / 2; }
    int blocks() const { return width / BLOCK + 1; }
    Word may(int y, int w) const {
        return ((const Word*)allowed)[(size_t)y * words() + w] | everywhere;
    }
    float share(float strength) const { return (float)((double)strength * quality); }

    // Whether a row has an allowed pixel.
    bool asks(int y) const {
        Word any = 0;
        for (int w = 0; w < words(); ++w) any |= may(y, w);
        return any != 0;
    }

    // Lists the allowed maxima above the share of the strongest allowed pixel; how many there are.
    int run() const {
        int top = 0, bottom = height - 1;
        while (top < height && !asks(top)) ++top;
        while (bottom > top && !asks(bottom)) --bottom;
        Rows rows;
        clear(rows);
        // Rows from one above the first of them on, and what these need of rows above.
        const int from = top > 0 ? top - 1 : 0, to = bottom + 1 < height ? bottom + 1 : bottom;
        for (int y = from > 1 ? from - 2 : 0; y <= from + 1 && y < height; ++y) read(rows, y);
        for (int y = from > 0 ? from - 1 : 0; y <= from && y < height; ++y) look(rows, y);
        float strongest = 0.0f;
        int count = 0;
        for (int y = from; y <= to + 1; ++y) {
            if (y <= to) {
                if (y + 2 < height) read(rows, y + 2);
                if (y + 1 < height) look(rows, y + 1);
                measure(rows, y, &strongest);
            }
            if (y > 1 && y > from && y < height) count = search(rows, y - 1, share(strongest), count);
        }
        // Most were above the share of what was the strongest then.
        const float limit = share(strongest);
        int kept = 0;
        for (int i = 0; i < count; ++i)
            if (strength_of(list_out[i]) > limit) list_out[kept++] = list_out[i];
        return kept;
    }

    void clear(Rows& rows) const {
        const int n = words();
        for (int k = 0; k < 3; ++k) {
            rows.count[k] = 0;
            for (int i = 0; i < blocks(); ++i) rows.summed[k][i] = false;
            for (int i = 0; i < blocks() * LANES; ++i) rows.most[k][i] = rows.least[k][i] = 0.0f;
        }
        for (int w = 0; w < n + 2; ++w) rows.none[w] = rows.here[w] = 0;
        for (int k = 0; k < RING; ++k) rows.sides[k][0] = rows.sides[k][n + 1] = 0;
        for (int k = 0; k < 3; ++k) rows.mask[k][0] = rows.mask[k][n + 1] = 0;
        for (int x = 0; x < width; ++x) rows.exact[x].row = -1;
    }

    static float strength_of(Word key) {
        const unsigned bits = (unsigned)(key >> 32);
        float value;
        __builtin_memcpy(&value, &bits, sizeof value);
        return value;
    }

    void read(Rows& rows, int y) const {
        const int n = words(), end = width + 64, inside = end - 2;
        Word* __restrict__ edge = rows.edge[y % RING];
        Word* __restrict__ sides = rows.sides[y % RING];
        for (int w = 0; w < n; ++w) edge[w + 1] = ((const Word*)edges)[(size_t)y * n + w];
        edge[0] = edge[1] << 62;
        edge[n + 1] = 0;
        edge[end / 64] |= (edge[inside / 64] >> inside % 64 & 1) << end % 64;
        for (int w = 1; w <= n; ++w)
            sides[w] = (edge[w] << 1 | edge[w - 1] >> 63) ^ (edge[w] >> 1 | edge[w + 1] << 63);
    }

    // Finds where row y may have a corner: pixels of an edge differ in both directions near it.
    void look(Rows& rows, int y) const {
        const int n = words(), up = y > 0 ? y - 1 : y, down = y + 1 < height ? y + 1 : y;
        const Word *a = rows.sides[up % RING], *o = rows.sides[y % RING];
        const Word* b = rows.sides[down % RING];
        const Word* above = y > 0 ? rows.edge[up % RING] : rows.none;
        const Word* below = y + 1 < height ? rows.edge[down % RING] : rows.none;
        Word* __restrict__ mask = rows.mask[y % 3];
        for (int w = 0; w < n; ++w) mask[w + 1] = may(y, w);
        if (width % 64) mask[n] &= (1ull << width % 64) - 1;
        Word* __restrict__ across = rows.across[y % 3];
        Word* __restrict__ along = rows.along[y % 3];
        Word* __restrict__ wide = rows.wide[y % 3];
        for (int w = 1; w <= n; ++w) {
            const Word left = a[w - 1] | o[w - 1] | b[w - 1], right = a[w + 1] | o[w + 1] | b[w + 1];
            across[w] = wider(left, a[w] | o[w] | b[w], right);
        }
        // A window has three columns.
        for (int w = 1; w <= n; ++w) {
            const Word left = above[w - 1] ^ below[w - 1], right = above[w + 1] ^ below[w + 1];
            const Word own = above[w] ^ below[w];
            along[w] = wider(left, own, right) | own << 2 | own >> 2 | left >> 62 | right << 62;
        }
        for (int w = 1; w <= n; ++w) wide[w] = wider(mask[w - 1], mask[w], mask[w + 1]);
    }

    static Word wider(Word left, Word own, Word right) {
        return own | own << 1 | own >> 1 | left >> 63 | right << 63;
    }

    // The strengths of row y, in the blocks that may have one above 0 next to an allowed pixel. One
    // step follows the other for all blocks, so that the processor works on several at once.
    void measure(Rows& rows, int y, float* strongest) const {
        const int slot = y % 3;
        int* list = rows.list[slot];
        for (int i = 0; i < rows.count[slot]; ++i)
            at(rows.most[slot], list[i]) = at(rows.least[slot], list[i]) = (Floats){};
        const int count = rows.count[slot] = find(rows, y);
        // Rows y - 1 .. y + 1 have sums, or get them where needed; y + 1 takes the place of y - 2.
        if (y > 0 && y + 1 < height)
            for (int i = 0; i < blocks(); ++i) rows.summed[(y + 1) % 3][i] = false;
        for (int k = -1; k <= 1; ++k) {
            const int row = PixelBits::mirrored(y + k, height);
            int missing[BLOCKS], n = 0;
            for (int i = 0; i < count; ++i) {
                missing[n] = list[i];
                n += !rows.summed[row % 3][list[i]];
                rows.summed[row % 3][list[i]] = true;
            }
            for (int i = 0; i < n; ++i) sum(rows, row, missing[i]);
        }
        for (int i = 0; i < count; ++i) strengths(rows, y, list[i]);
        for (int i = 0; i < count; ++i) {
            const Ints stronger = (Ints)(at(rows.most[slot], list[i]) > *strongest);
            unsigned left = Vectors::bits(stronger) >> SIDE & own(rows, y, list[i]);
            for (; left; left &= left - 1) {
                const int x = list[i] * BLOCK + __builtin_ctz(left);
                if (rows.most[slot][place(x)] <= *strongest) continue;
                const float strength = exactly(rows, x, y, place(x));
                if (strength > *strongest) *strongest = strength;
            }
        }
    }

    // Lists the blocks that row y's strengths are needed of; how many there are.
    int find(Rows& rows, int y) const {
        const int n = words(), slot = y % 3;
        const int up = (y > 0 ? y - 1 : y) % 3, down = (y + 1 < height ? y + 1 : y) % 3;
        const Word *x0 = rows.across[up], *x1 = rows.across[slot], *x2 = rows.across[down];
        const Word *y0 = rows.along[up], *y1 = rows.along[slot], *y2 = rows.along[down];
        const Word *m0 = rows.wide[up], *m1 = rows.wide[slot], *m2 = rows.wide[down];
        Word* __restrict__ here = rows.here;
        for (int w = 1; w <= n; ++w)
            here[w] =
                (x0[w] | x1[w] | x2[w]) & (y0[w] | y1[w] | y2[w]) & (m0[w] | m1[w] | m2[w]);
        if (width % 64) here[n] &= (1ull << width % 64) - 1;
        int* __restrict__ list = rows.list[slot];
        int count = 0;
        for (int block = 0; block < blocks(); ++block) {
            list[count] = block;
            count += (bits_from(here, block * BLOCK) & ALL) != 0;
        }
        return count;
    }

    // Where a block's vector is, and where a column is that is of its block.
    static Floats& at(float* row, int block) { return *(Floats*)(row + block * LANES); }
    static int place(int x) { return x / BLOCK * LANES + x % BLOCK + SIDE; }

    // A block's allowed columns.
    static unsigned own(const Rows& rows, int y, int block) {
        return bits_from(rows.mask[y % 3], block * BLOCK) & ALL;
    }

    // Bits from column `from` of a row on; a word of them begins at any byte.
    static unsigned bits_from(const Word* row, int from) {
        Word bits;
        __builtin_memcpy(&bits, (const char*)row + (from + 64) / 8, sizeof bits);
        return (unsigned)(bits >> (from + 64) % 8);
    }

    // The columns of a block's vector, and one more at both sides, of a row of edges.
    unsigned window(const Rows& rows, int y, int block) const {
        const int row = PixelBits::mirrored(y, height);
        return bits_from(rows.edge[row % RING], block * BLOCK - SIDE - 1);
    }

    // Sums of products over three columns in row y, from the second lane to the last but one.
    void sum(Rows& rows, int y, int block) const {
        const unsigned a = window(rows, y - 1, block), o = window(rows, y, block);
        const unsigned b = window(rows, y + 1, block);
        Floats left, right, above, below, own, middle;
        Vectors::pick(a, 1.0f, &left);
        Vectors::pick(a >> 2, 1.0f, &right);
        Vectors::pick(a >> 1, 2.0f, &middle);
        Floats h = right - left;
        above = (left + right + middle) * CornerStrength::step();
        Vectors::pick(b, 1.0f, &left);
        Vectors::pick(b >> 2, 1.0f, &right);
        Vectors::pick(b >> 1, 2.0f, &middle);
        h += right - left;
        below = (left + right + middle) * CornerStrength::step();
        Vectors::pick(o, 2.0f, &left);
        Vectors::pick(o >> 2, 2.0f, &right);
        own = h + (right - left);
        const Floats dx = own * CornerStrength::step(), dy = below - above;
        const float per_unit = CornerStrength::per_unit();
        put(rows, y, block, 0, __builtin_convertvector(dx * dx * per_unit, Ints));
        put(rows, y, block, 1, __builtin_convertvector(dx * dy * per_unit, Ints));
        put(rows, y, block, 2, __builtin_convertvector(dy * dy * per_unit, Ints));
    }

    void put(Rows& rows, int y, int block, int which, Ints product) const {
        // Products beside the image are those inside, mirrored.
        const int end = width - (block * BLOCK - SIDE);
        if (block == 0) product[SIDE - 1] = product[SIDE + 1];
        if (end < LANES) product[end] = product[end - 2];
        const Ints left = __builtin_shufflevector(product, product, 15, 0, 1, 2, 3, 4, 5, 6, 7, 8,
                                                  9, 10, 11, 12, 13, 14);
        const Ints right = __builtin_shufflevector(product, product, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10,
                                                   11, 12, 13, 14, 15, 0);
        *(Ints*)(rows.sums[y % 3][which] + block * LANES) = left + product + right;
    }

    void strengths(Rows& rows, int y, int block) const {
        Ints total[3] = {};
        for (int k = -1; k <= 1; ++k) {
            const int row = PixelBits::mirrored(y + k, height) % 3;
            for (int q = 0; q < 3; ++q)
                total[q] += *(const Ints*)(rows.sums[row][q] + block * LANES);
        }
        const float unit = CornerStrength::unit();
        const Floats a = 0.5f * (__builtin_convertvector((Unsigned)total[0], Floats) * unit);
        const Floats c = 0.5f * (__builtin_convertvector((Unsigned)total[2], Floats) * unit);
        const Floats t = a - c;
        const Ints size = total[1] < 0 ? -total[1] : total[1];
        const Vectors::Doubles exact = __builtin_convertvector(size, Vectors::Doubles);
        Floats low = __builtin_convertvector(exact - 0.25, Floats) * unit;
        low = low < 0.0f ? (Floats){} : low;
        const Floats high = __builtin_convertvector(exact + 0.25, Floats) * unit;
        Floats most, least;
        Vectors::root(t * t + low * low, &most);
        Vectors::root(t * t + high * high, &least);
        // Of columns of the image, but for the first and the last lane.
        const int before = block == 0 ? SIDE - 1 : 0, end = width - (block * BLOCK - SIDE);
        const Ints lane = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
        const Ints known = (lane > before) & (lane < (end < LANES ? end : LANES - 1));
        at(rows.most[y % 3], block) = known ? (a + c) - most : (Floats){};
        at(rows.least[y % 3], block) = known ? (a + c) - least : (Floats){};
    }

    // The strength of a pixel whose interval is known, at this place.
    float exactly(Rows& rows, int x, int y, int place) const {
        const float least = rows.least[y % 3][place], most = rows.most[y % 3][place];
        if (least == most) return least;
        const CornerColumn column = {edges, height, width, x};
        CornerColumn::State& state = rows.exact[x];
        if (state.row < 0 || y < state.row - EXACT) state = column.start();
        while (state.row <= y) {
            const int row = state.row;
            rows.exact_sums[row % EXACT][x] = column.next(&state);
        }
        return column.strength(y, rows.exact_sums[y % EXACT][x]);
    }

    // Lists the maxima of row y that are above the limit, behind `count` others.
    int search(Rows& rows, int y, float limit, int count) const {
        const int slot = y % 3;
        // Blocks that have some, and which of these are for sure.
        int list[BLOCKS], n = 0;
        unsigned may_be[BLOCKS], are[BLOCKS];
        for (int i = 0; i < rows.count[slot]; ++i) {
            const int block = rows.list[slot][i];
            const Floats most = at(rows.most[slot], block), least = at(rows.least[slot], block);
            Floats highest = most, lowest = least;
            for (int k = 0; k < 3; ++k) {
                raise(&highest, at(rows.most[k], block));
                raise(&lowest, at(rows.least[k], block));
            }
            widen(&highest);
            widen(&lowest);
            const Ints maximum = (Ints)(most > limit) & (Ints)(most >= lowest);
            list[n] = block;
            are[n] = Vectors::bits((Ints)(most == least) & (Ints)(most >= highest)) >> SIDE;
            may_be[n] = Vectors::bits(maximum) >> SIDE & own(rows, y, block);
            n += may_be[n] != 0;
        }
        for (int i = 0; i < n; ++i)
            for (unsigned left = may_be[i]; left; left &= left - 1) {
                const int lane = __builtin_ctz(left), x = list[i] * BLOCK + lane, at = place(x);
                if (x == 0 || x == width - 1) continue;  // The image's border has none.
                const float strength = exactly(rows, x, y, at);
                if (!(are[i] >> lane & 1) &&
                    (!(strength > limit) || !is_maximum(rows, x, y, at, strength)))
                    continue;
                unsigned bits;
                __builtin_memcpy(&bits, &strength, sizeof bits);
                list_out[count++] = (Word)bits << 32 | (unsigned)(y * width + x);
            }
        return count;
    }

    static void raise(Floats* values, const Floats& others) {
        *values = others > *values ? others : *values;
    }

    // Each becomes the largest of itself and those beside it.
    static void widen(Floats* values) {
        const Floats own = *values;
        raise(values, __builtin_shufflevector(own, own, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12,
                                              13, 14));
        raise(values, __builtin_shufflevector(own, own, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13,
                                              14, 15, 15));
    }

    bool is_maximum(Rows& rows, int x, int y, int place, float strength) const {
        for (int row = y - 1; row <= y + 1; ++row)
            for (int side = -1; side <= 1; ++side) {
                if (rows.most[row % 3][place + side] <= strength) continue;
                if (exactly(rows, x + side, row, place + side) > strength) return false;
            }
        return true;
    }
};
#else
// Exact strengths on CUDA, by a warp. Not inlined: it is code that few pixels need.
struct ExactCorner {
    enum { ALL = 0xffffffff };  // Lanes; unsigned.
    enum { WARP = 32 };

    int lane;
    const unsigned* edges;  // (height, PixelBits::words(width))
    int height, width;

    // Whether a pixel is the strongest of its 3x3 pixels, and its strength, exactly; x and y are
    // the same for all lanes. Nine of them take a pixel each.
    __noinline__ bool is_maximum(int x, int y, float* strength) const {
        const int which = lane < 9 ? lane : 4;
        float xy = 0.0f;
        for (int k = 0; k < 3; ++k) {
            float sums[3];
            const int u = min(max(x - 1 + k, 0), width - 1);
            add_up(u, y - 1, sums);
            #pragma unroll
            for (int i = 0; i < 3; ++i)
                if (which == 3 * k + i) xy = sums[i];
        }
        const int u = x - 1 + which / 3, v = y - 1 + which % 3;
        const bool inside = u >= 0 && u < width && v >= 0 && v < height;
        const CornerColumn column = {edges, height, width, inside ? u : x};
        const float own = inside ? column.strength(v, xy) : 0.0f;
        *strength = __shfl_sync(ALL, own, 4);
        return *strength > 0.0f && !__any_sync(ALL, own > *strength);
    }

    // The sums of dx dy around a column's rows first .. first + 2, as CornerColumn's; for all lanes
    // the same, which work out 32 rows at a time. They are added up one by one, but for rows where
    // neither what is added nor what is taken away is other than 0.
    void add_up(int x, int first, float* sums) const {
        const CornerColumn column = {edges, height, width, x};
        const CornerColumn::State start = column.start();
        double running = start.running, oldest = start.oldest, older = start.older;
        const int end = min(first + 3, height);
        for (int row = 0; row < end; row += WARP) {
            const int count = min((int)WARP, end - row);
            const double coming = lane < count ? column.row_sum(row + lane + 1) : 0.0;
            const unsigned some = __ballot_sync(ALL, coming != 0.0);
            unsigned left = some | some << 2 | (oldest != 0.0 ? 1u : 0u) | (older != 0.0 ? 2u : 0u);
            for (int i = 0; i < 3; ++i) {
                const int k = first + i - row;
                if (k >= 0 && k < count) left |= 1u << k;
            }
            if (count < WARP) left &= (1u << count) - 1;
            for (; left; left &= left - 1) {
                const int k = __ffs(left) - 1;
                const double total = running + __shfl_sync(ALL, coming, k);
                const double before = __shfl_sync(ALL, coming, k >= 2 ? k - 2 : 0);
                running = total - (k >= 2 ? before : k == 1 ? older : oldest);
                #pragma unroll
                for (int i = 0; i < 3; ++i)
                    if (row + k == first + i) sums[i] = (float)total;
            }
            oldest = __shfl_sync(ALL, coming, WARP - 2);
            older = __shfl_sync(ALL, coming, WARP - 1);
        }
    }
};

// A tile of a frame on CUDA, by a block of 128 threads. Rows of bits tell where a strength may be
// above 0 next to an allowed pixel of the tile. These pixels are few, so they are listed, and each
// thread works on its share of the list.
struct CornerTile {
    typedef unsigned long long Word;
    enum { ALL = 0xffffffff };  // Lanes; unsigned, as the numbers below are not.
    enum {
        THREADS = 128, WARP = 32,
        ROWS = 48, COLUMNS = 64,  // Of the tile.
        TALL = ROWS + 2, WIDE = COLUMNS + 2,  // Of its strengths.
        EDGE_ROWS = ROWS + 6, MASK_ROWS = ROWS + 4,
        // 32-bit words of a row of bits: the tile's two, and one more at both sides. Places in a
        // row are counted from the first word on.
        WORDS = COLUMNS / 32 + 2, PLACES = WORDS * 32, FIRST = 32,
    };

    int thread;
    const unsigned* edges;    // (height, PixelBits::words(width))
    const unsigned* allowed;  // Likewise.
    Word everywhere;          // All ones: the mask is not asked.
    int height, width;
    int top, left;            // The tile's first row and column.
    float* strength_out;      // (height, width), written at maxima alone.
    unsigned* maxima_out;     // (height, words), zero before: allowed 3x3 maxima above 0.
    int* strongest_out;       // The strongest allowed pixel's bits, 0 before.

    // Where a strength lies.
    struct alignas(8) Interval {
        float most, least;
    };

    struct Shared {
        Interval strength[TALL][WIDE];       // Of row top - 1 and column left - 1 on; 0 elsewhere.
        unsigned edge[EDGE_ROWS][WORDS];     // From row top - 3 on.
        unsigned mask[MASK_ROWS][WORDS];     // From row top - 2 on; 0 around the tile.
        unsigned short list[TALL * WIDE];    // Row of `strength` * PLACES + place.
        int count, strongest;
    };

    void run() const {
        __shared__ Shared shared;
        const bool asks = read(shared);
        if (thread == 0) shared.count = shared.strongest = 0;
        if (!__syncthreads_or(asks)) return;
        Interval* strength = &shared.strength[0][0];
        for (int i = thread; i < TALL * WIDE; i += THREADS) strength[i] = {0.0f, 0.0f};
        for (int i = thread; i < TALL * WORDS; i += THREADS) list(shared, i / WORDS, i % WORDS);
        __syncthreads();
        const int count = shared.count;
        if (count == 0) return;
        float bound = 0.0f;
        for (int i = thread; i < count; i += THREADS) {
            const int row = shared.list[i] / PLACES, place = shared.list[i] % PLACES;
            const Interval own = measure(shared, row, place);
            shared.strength[row][place - FIRST + 1] = own;
            if (is_allowed(shared, row, place)) bound = fmaxf(bound, own.least);
        }
        // The strongest pixel is at least that strong.
        const int bits = __reduce_max_sync(ALL, __float_as_int(bound));
        if (thread % WARP == 0) atomicMax(&shared.strongest, bits);
        __syncthreads();
        if (thread == 0 && shared.strongest > 0) atomicMax(strongest_out, shared.strongest);
        // Whatever others have written by now only saves work.
        bound = fmaxf(__int_as_float(shared.strongest), __int_as_float(*strongest_out));
        for (int first = thread / WARP * WARP; first < count; first += THREADS)
            search(shared, first + thread % WARP, count, bound);
    }

    // Rows of bits. Whether an allowed one is this thread's.
    bool read(Shared& shared) const {
        const int words = PixelBits::words(width) / 2, w = left / COLUMNS;
        if (thread < EDGE_ROWS) {
            // Beside the image edges are mirrored; rows further away decide nothing.
            const int y = PixelBits::mirrored(top - 3 + thread, height);
            unsigned* row = shared.edge[thread];
            Word before = 0, own = 0, after = 0;
            if (y >= 0 && y < height) {
                const Word* from = (const Word*)edges + (size_t)y * words;
                if (w > 0) before = from[w - 1];
                own = from[w];
                if (w + 1 < words) after = from[w + 1];
            }
            row[0] = (unsigned)(before >> 32);
            row[1] = (unsigned)own;
            row[2] = (unsigned)(own >> 32);
            row[3] = (unsigned)after;
            if (left == 0) row[0] = (row[1] & 2) << 30 | (row[1] & 4) << 28;
            const int end = width - left + FIRST;
            if (end < PLACES - 1)
                for (int k = 0; k < 2; ++k) {
                    const int from = end - 2 - k, to = end + k;
                    row[to / 32] |= (row[from / 32] >> (from % 32) & 1) << (to % 32);
                }
        }
        const int i = thread - (THREADS - MASK_ROWS), y = top - 2 + i;
        if (i < 0) return false;
        Word mask = 0;
        if (i >= 2 && i < 2 + ROWS && y < height) {
            mask = ((const Word*)allowed)[(size_t)y * words + w] | everywhere;
            if (width - left < COLUMNS) mask &= ((Word)1 << (width - left)) - 1;
        }
        shared.mask[i][0] = shared.mask[i][3] = 0;
        shared.mask[i][1] = (unsigned)mask;
        shared.mask[i][2] = (unsigned)(mask >> 32);
        return mask != 0;
    }

    static unsigned wider(unsigned left, unsigned own, unsigned right) {
        return own | own << 1 | own >> 1 | left >> 31 | right << 31;
    }

    // Lists the pixels of a word of a row of strengths that may have one above 0 and are next to an
    // allowed pixel: there pixels of an edge differ in both directions.
    void list(Shared& shared, int row, int w) const {
        const int y = top - 1 + row, x = left - FIRST + 32 * w;
        if (y < 0 || y >= height || (w == 0 && left == 0) || x >= width) return;
        unsigned near[3] = {0, 0, 0}, changes[3] = {0, 0, 0}, sides = 0, first = 0, last = 0;
        #pragma unroll
        for (int i = 0; i < 3; ++i) {
            if (w > 0) near[0] |= shared.mask[row + i][w - 1];
            near[1] |= shared.mask[row + i][w];
            if (w + 1 < WORDS) near[2] |= shared.mask[row + i][w + 1];
        }
        const unsigned wanted = wider(near[0], near[1], near[2]);
        if (wanted == 0) return;
        unsigned before[5], own[5], after[5];
        #pragma unroll
        for (int i = 0; i < 5; ++i) {
            before[i] = w > 0 ? shared.edge[row + i][w - 1] : 0;
            own[i] = shared.edge[row + i][w];
            after[i] = w + 1 < WORDS ? shared.edge[row + i][w + 1] : 0;
            // Of the columns left and right of the word as well.
            sides |= (own[i] << 1 | before[i] >> 31) ^ (own[i] >> 1 | after[i] << 31);
            first |= (before[i] >> 30 ^ own[i]) & 1;
            last |= (own[i] >> 31 ^ after[i] >> 1) & 1;
            if (i < 2) continue;
            changes[0] |= before[i] ^ before[i - 2];
            changes[1] |= own[i] ^ own[i - 2];
            changes[2] |= after[i] ^ after[i - 2];
        }
        const unsigned across = sides | sides << 1 | sides >> 1 | first | last << 31;
        const unsigned along = wider(changes[0], changes[1], changes[2]) | changes[1] << 2
            | changes[1] >> 2 | changes[0] >> 30 | changes[2] << 30;
        unsigned found = wanted & across & along;
        if (width - x < 32) found &= (1u << (width - x)) - 1;
        if (found == 0) return;
        int at = atomicAdd(&shared.count, __popc(found));
        for (; found; found &= found - 1)
            shared.list[at++] = (unsigned short)(row * PLACES + 32 * w + __ffs(found) - 1);
    }

    static bool is_allowed(const Shared& shared, int row, int place) {
        return shared.mask[row + 1][place / 32] >> (place % 32) & 1;
    }

    // The strength of a listed pixel. Beside the image the window is the mirror image of one
    // inside, so one of the gradients has the other sign there.
    Interval measure(const Shared& shared, int row, int place) const {
        const int y = top - 1 + row, x = left + place - FIRST, w = (place - 2) / 32;
        unsigned five[5];
        #pragma unroll
        for (int i = 0; i < 5; ++i) {
            const unsigned* from = &shared.edge[row + i][w];
            five[i] = __funnelshift_r(from[0], from[1], (place - 2) % 32);
        }
        const bool above = y == 0, below = y == height - 1;
        unsigned xx = 0, yy = 0;
        int xy = 0;
        #pragma unroll
        for (int k = 0; k < 3; ++k) {
            int column = 0;
            #pragma unroll
            for (int i = 0; i < 3; ++i) {
                int xx_one, xy_one, yy_one;
                CornerStrength::products(five[i] >> k & 7, five[i + 1] >> k & 7,
                                         five[i + 2] >> k & 7, &xx_one, &xy_one, &yy_one);
                xx += xx_one;
                yy += yy_one;
                column += (i == 0 && above) || (i == 2 && below) ? -xy_one : xy_one;
            }
            xy += (k == 0 && x == 0) || (k == 2 && x == width - 1) ? -column : column;
        }
        const float of_xx = (float)xx * CornerStrength::unit();
        const float of_yy = (float)yy * CornerStrength::unit();
        return {CornerStrength::eigenvalue(of_xx, CornerStrength::least(xy), of_yy),
                CornerStrength::eigenvalue(of_xx, CornerStrength::most(xy), of_yy)};
    }

    // Writes the maxima among a warp's listed pixels, and what is stronger than the bound. The few
    // whose intervals leave it open are looked at one by one, by all lanes.
    void search(const Shared& shared, int i, int count, float bound) const {
        const int listed = i < count ? shared.list[i] : PLACES;
        const int row = listed / PLACES, place = listed % PLACES;
        const int x = left + place - FIRST, y = top - 1 + row;
        const bool own = i < count && is_allowed(shared, row, place);
        Interval of = {0.0f, 0.0f};
        bool may = false, is = false;
        if (own) {
            const Interval* at = &shared.strength[row][place - FIRST + 1];
            of = *at;
            if (of.most > 0.0f && x >= 1 && x < width - 1 && y >= 1 && y < height - 1) {
                float most = 0.0f, least = 0.0f;
                #pragma unroll
                for (int k = -1; k <= 1; ++k)
                    #pragma unroll
                    for (int j = -1; j <= 1; ++j) {
                        most = fmaxf(most, at[k * WIDE + j].most);
                        least = fmaxf(least, at[k * WIDE + j].least);
                    }
                may = of.most >= least;
                is = may && of.most == of.least && of.most >= most;
            }
        }
        const unsigned stronger = __ballot_sync(ALL, own && of.least < of.most && of.most > bound);
        const unsigned open = __ballot_sync(ALL, may && !is);
        float strength = of.most;
        for (unsigned left = stronger | open; left; left &= left - 1) {
            const int turn = __ffs(left) - 1;
            const int u = __shfl_sync(ALL, x, turn), v = __shfl_sync(ALL, y, turn);
            float exact;
            const bool found =
                ExactCorner{thread % WARP, edges, height, width}.is_maximum(u, v, &exact);
            if (thread % WARP != turn) continue;
            is = may && found;
            strength = exact;
            if (exact > bound) atomicMax(strongest_out, __float_as_int(exact));
        }
        if (!is) return;
        strength_out[(size_t)y * width + x] = strength;
        atomicOr(&maxima_out[(size_t)y * PixelBits::words(width) + x / 32], 1u << (x % 32));
    }
};
#endif

} }  // namespace jaxdet
