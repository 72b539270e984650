// Hysteresis, the last step of Canny: the weak edges that are 8-connected to strong ones. Twin of
// `_connected_to` in jaxdet/reference/_canny.py. Images of bits, see pixel_bits.h.
#pragma once
#include "pixel_bits.h"

struct Hysteresis {
    typedef unsigned long long Word;
    enum { MAX_HEIGHT = 4096 };

    Team team;
    int height, width;
    const unsigned *weak, *strong;  // (height, PixelBits::words(width))
    unsigned* edges_out;            // Likewise.

    int row_words() const { return PixelBits::words(width) / 2; }

#if !defined(__CUDA_ARCH__)
    void run() const {
        const int n = row_words();
        Word* reached = (Word*)edges_out;
        for (int i = 0; i < height * n; ++i) reached[i] = ((const Word*)strong)[i];
        for (int y = 0; y < height; ++y) fill(y);
        // Rows that have not told the next one, below and above, what they reach.
        unsigned char tells[2][MAX_HEIGHT];
        for (int y = 0; y < height; ++y) tells[0][y] = tells[1][y] = 1;
        for (bool told = true; told;) {
            told = false;
            for (int up = 0; up < 2; ++up)
                for (int k = 0; k + 1 < height; ++k) {
                    const int from = up ? height - 1 - k : k, y = up ? from - 1 : from + 1;
                    if (!tells[up][from]) continue;
                    tells[up][from] = 0;
                    if (!spread(from, y)) continue;
                    fill(y);
                    tells[0][y] = tells[1][y] = 1;
                    told = true;
                }
        }
    }

    // Fills the runs of weak pixels in a row that hold a reached one.
    void fill(int y) const {
        const int n = row_words();
        const Word* c = (const Word*)weak + (size_t)y * n;
        Word* r = (Word*)edges_out + (size_t)y * n;
        Word carry = 0;
        for (int w = 0; w < n; ++w) {
            Word now = r[w] | (carry & c[w]);
            // A seed added to its run of ones carries to the run's end.
            if (now && (c[w] & ~now)) now |= c[w] & ~(c[w] + now);
            r[w] = now;
            carry = now >> 63;
        }
        carry = 0;
        for (int w = n - 1; w >= 0; --w) {
            Word now = r[w] | ((carry << 63) & c[w]);
            if (now && (c[w] & ~now)) {
                Word run = c[w];
                for (int step = 1; step < 64; step *= 2) {
                    now |= run & (now >> step);
                    run &= run >> step;
                }
            }
            r[w] = now;
            carry = now & 1;
        }
    }

    // What a row reaches in the next one.
    bool spread(int from, int y) const {
        const int n = row_words();
        const Word* f = (const Word*)edges_out + (size_t)from * n;
        const Word* c = (const Word*)weak + (size_t)y * n;
        Word* r = (Word*)edges_out + (size_t)y * n;
        Word any = 0;
        for (int w = 0; w < n; ++w) {
            Word near = f[w] | (f[w] << 1) | (f[w] >> 1);
            if (w > 0) near |= f[w - 1] >> 63;
            if (w + 1 < n) near |= f[w + 1] << 63;
            const Word fresh = near & c[w] & ~r[w];
            r[w] |= fresh;
            any |= fresh;
        }
        return any != 0;
    }
#else
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
#endif
};
