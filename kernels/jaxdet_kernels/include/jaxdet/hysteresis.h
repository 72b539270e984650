// Hysteresis, the last step of Canny: the weak edges that are 8-connected to strong ones. Twin of
// `_connected_to` in jaxdet/reference/_canny.py. Images of bits, see pixel_bits.h.
#pragma once
#include "pixel_bits.h"
#include "vectors.h"

namespace jaxdet { namespace {

#if !defined(__CUDA_ARCH__)
// A frame on the CPU. Images of bits are spaced: rows have room beyond the image, so that a vector of
// words ends in its row and a row in a word without pixels, which is next to the first word of the
// row below. A vector of zeros is before the first row and behind the last one.
struct Hysteresis {
    typedef unsigned long long Word;
    typedef Vectors::Longs Longs;
    enum { MAX_HEIGHT = 4096, VECTOR = Vectors::LONGS };

    int height, width;
    // Spaced (height, stride(width)): weak pixels and strong ones, which become the weak ones that
    // are not reached, and the reached ones.
    Word *open, *reached;
    unsigned* edges_out;  // (height, PixelBits::words(width))

    // Words of a spaced row, and of an image with the zeros around it.
    static int stride(int width) { return (width + 63) / 64 / VECTOR * VECTOR + VECTOR; }
    static size_t spaced(int height, int width) {
        return (size_t)height * stride(width) + 2 * VECTOR;
    }

    // The first row of an image in this memory; writes the zeros.
    static Word* rows(Word* memory, int height, int width) {
        Word *first = memory + VECTOR, *end = first + (size_t)height * stride(width);
        for (int i = 0; i < VECTOR; ++i) memory[i] = end[i] = 0;
        return first;
    }

    void run() const {
        const int n = stride(width), words = PixelBits::words(width) / 2;
        for (int i = 0; i < height * n; ++i) open[i] &= ~reached[i];
        // A worklist of rows, at first from top to bottom. It is a stack: where a row has grown,
        // its neighbours come next.
        int stack[MAX_HEIGHT], count = height;
        bool waits[MAX_HEIGHT];  // Whether a row is in it.
        for (int y = 0; y < height; ++y) {
            stack[height - 1 - y] = y;
            waits[y] = true;
        }
        while (count > 0) {
            const int y = stack[--count];
            waits[y] = false;
            if (!grow(y)) continue;
            for (int near = y < height - 1 ? y + 1 : y; near >= y - 1 && near >= 0; --near) {
                if (waits[near]) continue;
                waits[near] = true;
                stack[count++] = near;
            }
        }
        for (int y = 0; y < height; ++y)
            for (int w = 0; w < words; ++w)
                ((Word*)edges_out)[(size_t)y * words + w] = reached[(size_t)y * n + w];
    }

    // Reaches the runs of a row's open pixels that touch reached ones, in this row or beside it.
    bool grow(int y) const {
        const int n = stride(width);
        const Word* own = reached + (size_t)y * n;
        const Word *up = y > 0 ? own - n : own, *down = y + 1 < height ? own + n : own;
        bool grown = false;
        for (int w = 0; w < n; w += VECTOR) {
            const Longs here = at(up, w) | at(own, w) | at(down, w);
            const Longs left = at(up, w - 1) | at(own, w - 1) | at(down, w - 1);
            const Longs right = at(up, w + 1) | at(own, w + 1) | at(down, w + 1);
            const Longs near = here | here << 1 | here >> 1 | left >> 63 | right << 63;
            Longs& free = (Longs&)open[(size_t)y * n + w];
            Longs now = near & free;
            if (!Vectors::any(now)) continue;
            grown = true;
            // A seed added to its run of ones carries to the run's end.
            Longs run = free;
            now |= run & ~(run + now);
            for (int step = 1; step < 64; step *= 2) {
                now |= run & now >> step;
                run &= run >> step;
            }
            free &= ~now;
            (Longs&)reached[(size_t)y * n + w] |= now;
        }
        return grown;
    }

    static const Longs& at(const Word* row, int w) { return *(const Longs*)(row + w); }
};
#else
// A frame on CUDA, by a team.
struct Hysteresis {
    typedef unsigned long long Word;

    Team team;
    int height, width;
    const unsigned *weak, *strong;  // (height, PixelBits::words(width))
    unsigned* edges_out;            // Likewise.

    int row_words() const { return PixelBits::words(width) / 2; }

    // Reached pixels of images up to this many words lie in shared memory: 640 x 480, and a little
    // more. Those of larger images lie in the output.
    enum { SHARED = 4864, WARP = 32 };

    // Rows are dealt to strips. A strip belongs to a warp, and where rows are narrow to a part of
    // one: to as many lanes as a row has words. Reached pixels spread down and up in a strip until
    // it is stable; then all strips look whether the rows beside them changed meanwhile.
    void run() const {
        const unsigned all = 0xffffffffu;
        __shared__ Word kept[SHARED];
        const int n = row_words(), size = height * n;
        const Word* allowed = (const Word*)weak;
        const bool is_shared = size <= SHARED;
        volatile Word* reached = is_shared ? (volatile Word*)kept : (volatile Word*)edges_out;
        for (int i = team.rank; i < size; i += team.size) reached[i] = ((const Word*)strong)[i];
        team.sync();
        const int lane = team.rank % WARP, parts = (n + WARP - 1) / WARP;
        const int across = parts > 1 ? WARP : n, groups = WARP / across;
        const int group = lane / across, column = lane % across;
        const int strips = team.size / WARP * groups, rows = (height + strips - 1) / strips;
        const int strip = team.rank / WARP * groups + group;
        const int first = group < groups ? min(strip * rows, height) : height;
        const int last = min(first + rows, height);
        const bool some = first < last;
        Word above_seen = 0, below_seen = 0;
        bool first_time = true;
        int changed;
        do {
            changed = 0;
            bool look = first_time || parts > 1;
            first_time = false;
            if (parts == 1 && some) {
                const Word above = first > 0 ? reached[(first - 1) * n + column] : 0;
                const Word below = last < height ? reached[last * n + column] : 0;
                look |= above != above_seen || below != below_seen;
                above_seen = above;
                below_seen = below;
            }
            for (look = __any_sync(all, look); look;) {
                bool moved = false;
                for (int turn = 0; turn < 2 * parts; ++turn) {
                    const bool down = turn % 2 == 0;
                    const int word = turn / 2 * WARP + column;
                    const bool mine = some && word < n;
                    const int from = down ? first - 1 : last;
                    Word previous = 0;
                    if (mine && from >= 0 && from < height) previous = reached[from * n + word];
                    for (int k = 0; k < rows; ++k) {
                        const int y = down ? first + k : first + rows - 1 - k;
                        const bool here = mine && y < last;
                        const Word c = here ? allowed[y * n + word] : 0;
                        const Word old = here ? reached[y * n + word] : 0;
                        Word near = previous | (previous << 1) | (previous >> 1);
                        near |= beside(previous, column, across);
                        if (parts > 1 && here)
                            near |= beyond(reached, y, word, lane, n) |
                                beyond(reached, down ? y - 1 : y + 1, word, lane, n);
                        const Word now = run_of(old | (near & c), c, column, across);
                        if (now != old) {
                            reached[y * n + word] = now;
                            moved = true;
                            if (parts > 1 || y == first || y == last - 1) changed = 1;
                        }
                        // Rows beyond the last one pass on what comes from below.
                        if (here) previous = now;
                    }
                }
                look = parts == 1 && __any_sync(all, moved);
            }
        } while (__syncthreads_or(changed));
        if (is_shared)
            for (int i = team.rank; i < size; i += team.size) ((Word*)edges_out)[i] = reached[i];
    }

    // The bits of the words left and right that are next to this one; all lanes ask.
    static Word beside(Word word, int column, int across) {
        const Word left = __shfl_up_sync(0xffffffffu, word, 1);
        const Word right = __shfl_down_sync(0xffffffffu, word, 1);
        return (column > 0 ? left >> 63 : 0) | (column + 1 < across ? right << 63 : 0);
    }

    // Those next to the first and the last word that a warp looks at in a row of more words.
    Word beyond(volatile Word* reached, int y, int word, int lane, int n) const {
        if (y < 0 || y >= height) return 0;
        if (lane == 0 && word > 0) return reached[y * n + word - 1] >> 63;
        if (lane == WARP - 1 && word + 1 < n) return reached[y * n + word + 1] << 63;
        return 0;
    }

    // The runs of weak pixels `c` of a row that hold a reached one; all lanes ask.
    static Word run_of(Word now, Word c, int column, int across) {
        while (true) {
            // A seed added to its run of ones carries to the run's end.
            const Word up = (c & ~(c + now)) | now;
            const Word rc = __brevll(c), rs = __brevll(up);
            const Word full = __brevll((rc & ~(rc + rs)) | rs);
            now = full | (beside(full, column, across) & c);
            if (!__any_sync(0xffffffffu, now != full)) return now;
        }
    }
};
#endif

} }  // namespace jaxdet
