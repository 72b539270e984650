// Local maxima of the corner strength of an edge image, where a mask allows them. Twin of
// `strongest_corners` in jaxdet/reference/_corners.py, but for the minimum distance: see
// corner_selection.h. Strengths are worked out near allowed pixels only; no image of them is made.
//
// A strength is known as an interval first, see corner_strength.h, and exactly where that decides.
#pragma once
#include "corner_strength.h"
#include "vectors.h"

#if !defined(__CUDA_ARCH__)
// A frame on the CPU, row by row, in vectors. A vector has 16 columns, from one left of a block of
// 14 to one right of it, so that sums over three columns need nothing of other blocks.
struct CornerMaxima {
    typedef unsigned long long Word;
    typedef Vectors::Floats Floats;
    typedef Vectors::Ints Ints;
    typedef Vectors::Unsigned Unsigned;
    enum {
        MAX_SIZE = 4096,
        LANES = Vectors::FLOATS, BLOCK = LANES - 2,
        BEFORE = LANES,                  // Column x of a row of strengths is at BEFORE + x.
        ROW = MAX_SIZE + 3 * LANES,
        BLOCKS = MAX_SIZE / BLOCK + 1, BLOCK_WORDS = BLOCKS / 64 + 1,
        WORDS = MAX_SIZE / 64,
        EXACT = 4,                       // Rows whose exact sums are kept.
    };

    const unsigned* edges;    // (height, PixelBits::words(width))
    const unsigned* allowed;  // Likewise.
    Word everywhere;          // All ones: the mask is not asked.
    int height, width;
    double quality;           // Share of the strongest allowed strength that a corner exceeds.
    Word* list_out;           // (height * width), strength << 32 | place, by place.

    // What is known of some rows; row y is at y % 3. All but exact sums are 0 where nothing is near.
    struct Rows {
        int sums[3][3][BLOCKS * LANES];    // Of xx, xy and yy over three columns, of a block's.
        Word summed[3][BLOCK_WORDS];       // The blocks that have them.
        float most[3][ROW], least[3][ROW]; // The strengths' intervals.
        Word blocks[3][BLOCK_WORDS];       // The blocks that have strengths.
        // Rows of bits, word w at w + 1: the mask, edges, and where edges left and right differ.
        Word mask[WORDS + 2], edge[4][WORDS + 2], sides[4][WORDS + 2], none[WORDS + 2];
        // Where dx and dy may not be 0, and the mask, each a pixel wider left and right.
        Word across[3][WORDS], along[3][WORDS], wide[3][WORDS];
        CornerColumn::State exact[MAX_SIZE];
        float exact_sums[EXACT][MAX_SIZE]; // The last of each column's, row y at y % EXACT.
    };

    int words() const { return PixelBits::words(width) / 2; }
    const Word* edge_row(int y) const { return (const Word*)edges + (size_t)y * words(); }
    Word may(int y, int w) const {
        return ((const Word*)allowed)[(size_t)y * words() + w] | everywhere;
    }
    float share(float strength) const { return (float)((double)strength * quality); }

    // Lists the allowed maxima above the share of the strongest allowed pixel; how many there are.
    int run() const {
        Rows rows;
        const int n = words();
        for (int k = 0; k < 3; ++k) {
            for (int i = 0; i < BLOCK_WORDS; ++i) rows.summed[k][i] = rows.blocks[k][i] = 0;
            for (int i = 0; i < n * 64 + 3 * LANES && i < ROW; ++i)
                rows.most[k][i] = rows.least[k][i] = 0.0f;
        }
        for (int w = 0; w < n + 2; ++w) rows.none[w] = rows.mask[w] = 0;
        for (int k = 0; k < 4; ++k)
            rows.edge[k][0] = rows.edge[k][n + 1] = rows.sides[k][0] = rows.sides[k][n + 1] = 0;
        for (int x = 0; x < width; ++x) rows.exact[x].row = -1;
        for (int y = 0; y < 2; ++y) read(rows, y);
        look(rows, 0);
        float strongest = 0.0f;
        int count = 0;
        for (int y = 0; y <= height; ++y) {
            if (y < height) {
                if (y + 2 < height) read(rows, y + 2);
                if (y + 1 < height) look(rows, y + 1);
                measure(rows, y, &strongest);
            }
            if (y > 1 && y < height) count = search(rows, y - 1, share(strongest), count);
        }
        // Most were above the share of what was the strongest then.
        const float limit = share(strongest);
        int kept = 0;
        for (int i = 0; i < count; ++i)
            if (strength_of(list_out[i]) > limit) list_out[kept++] = list_out[i];
        return kept;
    }

    static float strength_of(Word key) {
        const unsigned bits = (unsigned)(key >> 32);
        float value;
        __builtin_memcpy(&value, &bits, sizeof value);
        return value;
    }

    void read(Rows& rows, int y) const {
        const int n = words();
        Word* __restrict__ edge = rows.edge[y % 4];
        Word* __restrict__ sides = rows.sides[y % 4];
        for (int w = 0; w < n; ++w) edge[w + 1] = edge_row(y)[w];
        for (int w = 1; w <= n; ++w)
            sides[w] = (edge[w] << 1 | edge[w - 1] >> 63) ^ (edge[w] >> 1 | edge[w + 1] << 63);
    }

    // Finds where row y may have a corner: pixels of an edge differ in both directions near it.
    // Beside the image they do not, as it is mirrored there, but it does no harm to say so.
    void look(Rows& rows, int y) const {
        const int n = words(), up = y > 0 ? y - 1 : y, down = y + 1 < height ? y + 1 : y;
        const Word *a = rows.sides[up % 4], *o = rows.sides[y % 4], *b = rows.sides[down % 4];
        const Word* above = y > 0 ? rows.edge[up % 4] : rows.none;
        const Word* below = y + 1 < height ? rows.edge[down % 4] : rows.none;
        for (int w = 0; w < n; ++w) rows.mask[w + 1] = may(y, w);
        Word* __restrict__ across = rows.across[y % 3];
        Word* __restrict__ along = rows.along[y % 3];
        Word* __restrict__ wide = rows.wide[y % 3];
        for (int w = 1; w <= n; ++w) {
            const Word left = a[w - 1] | o[w - 1] | b[w - 1], right = a[w + 1] | o[w + 1] | b[w + 1];
            across[w - 1] = wider(left, a[w] | o[w] | b[w], right);
        }
        // A window has three columns.
        for (int w = 1; w <= n; ++w) {
            const Word left = above[w - 1] ^ below[w - 1], right = above[w + 1] ^ below[w + 1];
            const Word own = above[w] ^ below[w];
            along[w - 1] = wider(left, own, right) | own << 2 | own >> 2 | left >> 62 | right << 62;
        }
        for (int w = 1; w <= n; ++w)
            wide[w - 1] = wider(rows.mask[w - 1], rows.mask[w], rows.mask[w + 1]);
    }

    static Word wider(Word left, Word own, Word right) {
        return own | own << 1 | own >> 1 | left >> 63 | right << 63;
    }

    // The strengths of row y, in the blocks that may have one above 0 next to an allowed pixel.
    void measure(Rows& rows, int y, float* strongest) const {
        const int slot = y % 3, n = words();
        // Rows y - 1 .. y + 1 have sums, or get them where needed; y + 1 takes the place of y - 2.
        Word* fresh = rows.summed[(y + 1) % 3];
        if (y == 0) {
            for (int k = 0; k < 3; ++k) clear(rows.summed[k]);
        } else if (y + 1 < height) {
            clear(fresh);
        }
        for (int i = 0; i < BLOCK_WORDS; ++i)
            for (Word left = rows.blocks[slot][i]; left; left &= left - 1) {
                const int first = BEFORE + (i * 64 + __builtin_ctzll(left)) * BLOCK;
                for (int k = first; k < first + BLOCK; ++k)
                    rows.most[slot][k] = rows.least[slot][k] = 0.0f;
            }
        clear(rows.blocks[slot]);
        const int up = y > 0 ? y - 1 : y, down = y + 1 < height ? y + 1 : y;
        const Word *x0 = rows.across[up % 3], *x1 = rows.across[slot], *x2 = rows.across[down % 3];
        const Word *y0 = rows.along[up % 3], *y1 = rows.along[slot], *y2 = rows.along[down % 3];
        const Word *m0 = rows.wide[up % 3], *m1 = rows.wide[slot], *m2 = rows.wide[down % 3];
        int done = 0;  // Blocks up to here.
        for (int w = 0; w < n; ++w) {
            Word here = (x0[w] | x1[w] | x2[w]) & (y0[w] | y1[w] | y2[w]) & (m0[w] | m1[w] | m2[w]);
            if (w == n - 1 && width % 64) here &= (1ull << width % 64) - 1;
            while (true) {
                // What is left of the word, but for columns of blocks that are done.
                const int from = done * BLOCK - w * 64;
                if (from >= 64) break;
                if (from > 0) here &= ~0ull << from;
                if (!here) break;
                const int block = (w * 64 + __builtin_ctzll(here)) / BLOCK;
                strengths(rows, y, block, strongest);
                rows.blocks[slot][block / 64] |= 1ull << block % 64;
                done = block + 1;
            }
        }
    }

    static void clear(Word* blocks) {
        for (int i = 0; i < BLOCK_WORDS; ++i) blocks[i] = 0;
    }

    // Bits from column `from` of a row on, at least -2; those left of the image are 0.
    static unsigned bits_from(const Word* row, int n, int from) {
        if (from < 0) return (unsigned)(row[0] << -from);
        const int w = from / 64, shift = from % 64;
        Word bits = row[w] >> shift;
        if (shift > 32 && w + 1 < n) bits |= row[w + 1] << (64 - shift);
        return (unsigned)bits;
    }

    // The columns left of a block to right of it, and one more at both sides, of a row of edges;
    // mirrored beside the image.
    unsigned window(int y, int block) const {
        const int from = block * BLOCK - 2, end = width - from;
        unsigned bits = bits_from(edge_row(PixelBits::mirrored(y, height)), words(), from);
        if (from < 0) bits |= (bits >> 2 & 2);          // Column -1, as column 1.
        if (end < 32) bits |= (bits >> (end - 2) & 1) << end;
        return bits;
    }

    // Sums of products over three columns in row y, from the second lane to the last but one.
    void sum(Rows& rows, int y, int block) const {
        const unsigned a = window(y - 1, block), o = window(y, block), b = window(y + 1, block);
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
        const int end = width - (block * BLOCK - 1);
        if (block == 0) product[0] = product[2];
        if (end < LANES) product[end] = product[end - 2];
        const Ints left = __builtin_shufflevector(product, product, 15, 0, 1, 2, 3, 4, 5, 6, 7, 8,
                                                  9, 10, 11, 12, 13, 14);
        const Ints right = __builtin_shufflevector(product, product, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10,
                                                   11, 12, 13, 14, 15, 0);
        *(Ints*)(rows.sums[y % 3][which] + block * LANES) = left + product + right;
    }

    void strengths(Rows& rows, int y, int block, float* strongest) const {
        Ints total[3] = {};
        for (int k = -1; k <= 1; ++k) {
            const int row = PixelBits::mirrored(y + k, height);
            Word* summed = &rows.summed[row % 3][block / 64];
            if (!(*summed >> block % 64 & 1)) sum(rows, row, block);
            *summed |= 1ull << block % 64;
            for (int q = 0; q < 3; ++q)
                total[q] += *(const Ints*)(rows.sums[row % 3][q] + block * LANES);
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
        Floats root;
        Vectors::root(t * t + low * low, &root);
        Floats most = (a + c) - root;
        Vectors::root(t * t + high * high, &root);
        Floats least = (a + c) - root;
        // Only the block's columns are known.
        const int first = block * BLOCK, end = width - first + 1;
        const Ints lane = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
        const Ints known = (lane >= 1) & (lane <= (end <= BLOCK ? end - 1 : (int)BLOCK));
        float* to_most = rows.most[y % 3] + BEFORE + first - 1;
        float* to_least = rows.least[y % 3] + BEFORE + first - 1;
        most = known ? most : *(const Floats*)to_most;
        least = known ? least : *(const Floats*)to_least;
        *(Floats*)to_most = most;
        *(Floats*)to_least = least;
        unsigned left = may_from(y, first - 1)
            & Vectors::bits((Ints)(most > *strongest)) & Vectors::bits(known);
        for (; left; left &= left - 1) {
            const int x = first - 1 + __builtin_ctz(left);
            if (rows.most[y % 3][BEFORE + x] <= *strongest) continue;
            const float strength = exactly(rows, x, y);
            if (strength > *strongest) *strongest = strength;
        }
    }

    // Of the mask, from column `from` on.
    unsigned may_from(int y, int from) const {
        return bits_from((const Word*)allowed + (size_t)y * words(), words(), from)
            | (unsigned)everywhere;
    }

    // The strength of a pixel whose interval is known.
    float exactly(Rows& rows, int x, int y) const {
        const float least = rows.least[y % 3][BEFORE + x], most = rows.most[y % 3][BEFORE + x];
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
        for (int i = 0; i < BLOCK_WORDS; ++i)
            for (Word blocks = rows.blocks[slot][i]; blocks; blocks &= blocks - 1) {
                const int first = (i * 64 + __builtin_ctzll(blocks)) * BLOCK;
                // The 14 lanes of the block and two more; the image's border has no corners.
                unsigned left = may_from(y, first) & ((1u << BLOCK) - 1);
                if (first == 0) left &= ~1u;
                if (width - 1 - first < BLOCK) left &= (1u << (width - 1 - first)) - 1;
                if (!left) continue;
                const Floats most = *(const Floats*)(rows.most[slot] + BEFORE + first);
                Ints maximum = (Ints)(most > limit);
                for (int k = 0; k < 3; ++k) {
                    const float* near = rows.least[k] + BEFORE + first;
                    for (int side = -1; side <= 1; ++side)
                        maximum &= (Ints)(most >= *(const Floats*)(near + side));
                }
                for (left &= Vectors::bits(maximum); left; left &= left - 1) {
                    const int x = first + __builtin_ctz(left);
                    const float strength = exactly(rows, x, y);
                    if (!(strength > limit) || !is_maximum(rows, x, y, strength)) continue;
                    unsigned bits;
                    __builtin_memcpy(&bits, &strength, sizeof bits);
                    list_out[count++] = (Word)bits << 32 | (unsigned)(y * width + x);
                }
            }
        return count;
    }

    bool is_maximum(Rows& rows, int x, int y, float strength) const {
        for (int row = y - 1; row <= y + 1; ++row)
            for (int u = x - 1; u <= x + 1; ++u) {
                if (rows.most[row % 3][BEFORE + u] <= strength) continue;
                if (exactly(rows, u, row) > strength) return false;
            }
        return true;
    }
};
#else
// A part of a frame on CUDA, by a warp: 28 columns, a lane each and two more at both sides, and as
// many rows as a warp can hold with three more above and below, a lane each.
struct CornerStrip {
    typedef unsigned long long Word;
    enum { WARP = 32, COLUMNS = WARP - 4, ROWS = WARP - 6, ALL = 0xffffffff };

    int lane;
    const unsigned* edges;    // (height, PixelBits::words(width))
    const unsigned* allowed;  // Likewise.
    Word everywhere;          // All ones: the mask is not asked.
    int height, width;
    int top, left;            // The first row and column.
    float* strength_out;      // (height, width), written at maxima alone.
    unsigned* maxima_out;     // (height, words), zero before: allowed 3x3 maxima above 0.
    int* strongest_out;       // The strongest allowed pixel's bits, 0 before.

    static int strips(int width) { return (width + COLUMNS - 1) / COLUMNS; }
    static int chunks(int height) { return (height + ROWS - 1) / ROWS; }

    // What lane l has of row top - 3 + l: bit j is column left - 3 + j, as far as a lane needs it.
    Word row_bits(const unsigned* image, int y) const {
        const int from = left - 3, words = PixelBits::words(width), shift = from & 31;
        const int w = (from - shift) / 32;
        const unsigned* row = image + (size_t)y * words;
        const Word first = w >= 0 ? row[w] : 0;
        const Word second = w + 1 < words ? row[w + 1] : 0;
        const Word third = w + 2 < words ? row[w + 2] : 0;
        const Word bits = (first | second << 32) >> shift;
        return shift ? bits | third << (64 - shift) : bits;
    }

    // Of edges, mirrored beside the image.
    Word edge_bits(int y) const {
        const int from = left - 3, row = PixelBits::mirrored(y, height);
        if (row < 0 || row >= height) return 0;
        Word bits = row_bits(edges, row);
        const int end = width - from;  // Columns width and width + 1 are width - 2 and width - 3.
        if (end < 34) {
            bits &= ((Word)1 << end) - 1;
            bits |= (bits >> (end - 2) & 1) << end | (bits >> (end - 3) & 1) << (end + 1);
        }
        // Bits 1 and 2, columns -2 and -1, are columns 2 and 1.
        if (left == 0) bits |= (bits >> 4 & 2) | (bits >> 2 & 4);
        return bits & 0x3ffffffffull;
    }

    // Of the mask: the strip's own columns.
    Word allowed_bits(int y) const {
        if (y < 0 || y >= height) return 0;
        const int columns = min((int)COLUMNS, width - left);
        return (row_bits(allowed, y) | everywhere) & ((((Word)1 << columns) - 1) << 3);
    }

    struct Sums {
        unsigned xx, yy;
        int xy;
    };

    void run() const {
        const int first = top - 3, x = left - 2 + lane;
        const Word edge = edge_bits(first + lane), may = allowed_bits(first + lane);
        // Rows as bits: strengths are needed next to allowed pixels, and are 0 far from edges.
        const unsigned wanted = __ballot_sync(ALL, may != 0), some = __ballot_sync(ALL, edge != 0);
        unsigned active = (wanted | wanted << 1 | wanted >> 1)
            & (some | some << 1 | some << 2 | some >> 1 | some >> 2) & 0x3ffffffcu;
        if (first < 0) active &= ~0u << -first;
        if (height - first < WARP) active &= (1u << (height - first)) - 1;
        if (!active) return;
        const unsigned summed = active | active << 1 | active >> 1;
        const bool own = lane >= 2 && lane < 2 + COLUMNS && x < width;
        const bool inner = own && x >= 1 && x < width - 1;
        const bool beside = x < 0 || x >= width;
        float strongest = 0.0f;
        // The last three sums of rows, and the intervals of the last two strengths.
        Sums older = {0, 0, 0}, old = older, fresh = older;
        float most1 = 0.0f, least1 = 0.0f, most2 = 0.0f, least2 = 0.0f;
        for (int r = 1; r < WARP - 1; ++r) {
            older = old;
            old = fresh;
            if (summed >> r & 1) fresh = sum(edge, r, beside);
            float most = 0.0f, least = 0.0f;
            if (active >> (r - 1) & 1) {
                measure({older.xx + old.xx + fresh.xx, older.yy + old.yy + fresh.yy,
                         older.xy + old.xy + fresh.xy}, &most, &least);
                // The rows above and below the strip are others'.
                const bool mine = __shfl_sync(ALL, may, r - 1) >> (lane + 1) & 1;
                if (r - 1 >= 3 && r - 1 < 3 + ROWS)
                    strongest = strongest_of(mine && own, x, first + r - 1, most, least, strongest);
            }
            // Row r - 2, whose neighbours are known now.
            const int y = first + r - 2;
            if (r - 2 >= 3 && (active >> (r - 2) & 1) && y >= 1 && y < height - 1) {
                const bool mine = __shfl_sync(ALL, may, r - 2) >> (lane + 1) & 1;
                search(mine && inner, x, y, fmaxf(fmaxf(most2, most1), most),
                       fmaxf(fmaxf(least2, least1), least), most1, least1);
            }
            most2 = most1;
            least2 = least1;
            most1 = most;
            least1 = least;
        }
        const int bits = __reduce_max_sync(ALL, __float_as_int(strongest));
        if (lane == 0 && bits > 0) atomicMax(strongest_out, bits);
    }

    // Sums over three columns of the products in the row of lane r. Beside the image the window is
    // the mirror image of one inside, so one of the gradients has the other sign there.
    Sums sum(Word edge, int r, bool beside) const {
        const Word above = __shfl_sync(ALL, edge, r - 1), own = __shfl_sync(ALL, edge, r);
        const Word below = __shfl_sync(ALL, edge, r + 1);
        const int y = top - 3 + r;
        int xx, xy, yy;
        CornerStrength::products((unsigned)(above >> lane) & 7, (unsigned)(own >> lane) & 7,
                                 (unsigned)(below >> lane) & 7, &xx, &xy, &yy);
        if (beside != (y < 0 || y >= height)) xy = -xy;
        return {(unsigned)three(xx), (unsigned)three(yy), three(xy)};
    }

    static int three(int value) {
        return __shfl_up_sync(ALL, value, 1) + value + __shfl_down_sync(ALL, value, 1);
    }

    static void measure(const Sums& sums, float* most, float* least) {
        const float xx = (float)sums.xx * CornerStrength::unit();
        const float yy = (float)sums.yy * CornerStrength::unit();
        *most = CornerStrength::eigenvalue(xx, CornerStrength::least(sums.xy), yy);
        *least = CornerStrength::eigenvalue(xx, CornerStrength::most(sums.xy), yy);
    }

    // The strongest so far of this lane, with its pixel; all lanes ask.
    float strongest_of(bool mine, int x, int y, float most, float least, float strongest) const {
        if (mine && least == most) strongest = fmaxf(strongest, most);
        const bool doubt = mine && least != most && most > strongest;
        for (unsigned left = __ballot_sync(ALL, doubt); left; left &= left - 1) {
            const int turn = __ffs(left) - 1, column = __shfl_sync(ALL, x, turn);
            float sums[3];
            add_up(column, y, y, sums);
            const CornerColumn of = {edges, height, width, column};
            const float exact = of.strength(y, sums[0]);
            if (lane == turn) strongest = fmaxf(strongest, exact);
        }
        return strongest;
    }

    // Whether row y's pixel is a maximum; all lanes ask. Given are the largest values of its
    // column's three pixels, and its own.
    void search(bool mine, int x, int y, float tallest_most, float tallest_least, float most,
                float least) const {
        const float near_most = widest(tallest_most), near_least = widest(tallest_least);
        const bool maybe = mine && most > 0.0f && most >= near_least;
        const bool sure = maybe && most == least && most >= near_most;
        float strength = most;
        bool found = sure;
        for (unsigned left = __ballot_sync(ALL, maybe && !sure); left; left &= left - 1) {
            const int turn = __ffs(left) - 1, column = __shfl_sync(ALL, x, turn);
            float exact;
            const bool is = is_maximum(column, y, &exact);
            if (lane != turn) continue;
            found = is;
            strength = exact;
        }
        if (!found) return;
        strength_out[(size_t)y * width + x] = strength;
        atomicOr(&maxima_out[(size_t)y * PixelBits::words(width) + x / 32], 1u << (x % 32));
    }

    static float widest(float value) {
        const float left = __shfl_up_sync(ALL, value, 1), right = __shfl_down_sync(ALL, value, 1);
        return fmaxf(fmaxf(left, value), right);
    }

    // Exactly; x and y are the same for all lanes. Nine of them take a pixel each.
    bool is_maximum(int x, int y, float* strength) const {
        float xy = 0.0f;
        for (int k = 0; k < 3; ++k) {
            float sums[3];
            add_up(x - 1 + k, y - 1, y + 1, sums);
            for (int i = 0; i < 3; ++i)
                if (lane == 3 * k + i) xy = sums[i];
        }
        const int which = lane < 9 ? lane : 4;
        xy = __shfl_sync(ALL, xy, which);
        const CornerColumn column = {edges, height, width, x - 1 + which / 3};
        const float own = column.strength(y - 1 + which % 3, xy);
        *strength = __shfl_sync(ALL, own, 4);
        return *strength > 0.0f && !__any_sync(ALL, own > *strength);
    }

    // The sums of dx dy of a column's rows y0 .. y1, at most three, as CornerColumn's; for all
    // lanes the same. Lanes work out 32 rows at a time, which are added up one by one.
    void add_up(int x, int y0, int y1, float* sums) const {
        const CornerColumn column = {edges, height, width, x};
        CornerColumn::State state = column.start();
        while (state.row <= y1) {
            const int row = state.row + lane, count = min((int)WARP, y1 + 1 - state.row);
            const double coming = lane < count ? column.row_sum(row + 1) : 0.0;
            if (state.row + count <= y0 && !__any_sync(ALL, coming != 0.0) && state.oldest == 0.0
                && state.older == 0.0) {
                state.row += count;
                continue;
            }
            for (int k = 0; k < count; ++k) {
                const int at = state.row - y0;
                const float total = column.add(&state, __shfl_sync(ALL, coming, k));
                if (at >= 0) sums[at] = total;
            }
        }
    }
};
#endif
