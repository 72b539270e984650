// The strongest corners that keep a minimum distance, strongest first: greedy non-maximum
// suppression. Twin of `_without_near` in jaxdet/reference/_corners.py: in order of falling
// strength, of equals the last in raster order first, a corner is taken unless one that was taken
// is nearer than the distance.
#pragma once
#include "pixel_bits.h"
#include "square_root.h"

namespace jaxdet { namespace {

// Pixels nearer than the distance: those whose squared distance, a whole number, is below `limit`.
struct CornerDisk {
    int limit;  // The square of the distance, rounded up; 0: no distance.

    // How far up and down the disk reaches; -1 if there is none.
    int reach() const { return half(0); }

    // Half its row that is dy rows away; negative if there is none.
    int half(int dy) const {
        const int left = limit - dy * dy;
        if (left <= 0) return -1;
        int side = (int)SquareRoot::rounded((float)left);
        while (side > 0 && side * side >= left) --side;
        while ((side + 1) * (side + 1) < left) ++side;
        return side;
    }
};

#if !defined(__CUDA_ARCH__)
// A frame on the CPU, one corner after the other.
struct CornerSelection {
    typedef unsigned long long Key;  // strength << 32 | place
    enum { MAX_SIZE = 4096, BINS = 256 };

    int height, width;
    CornerDisk disk;
    int slots;
    Key *list, *other;    // The corners, by place, and as much scratch memory.
    int count;            // Of them.
    unsigned* blocked;    // Scratch: (height, PixelBits::words(width))
    int *u_out, *v_out;   // (slots), zero where there is no corner.

    // How many corners there are, at most one more than slots.
    int run() {
        const int words = PixelBits::words(width), reach = disk.reach();
        sort();
        for (int i = 0; i < height * words; ++i) blocked[i] = 0;
        int halves[MAX_SIZE];
        for (int dy = 0; dy <= reach && dy < height; ++dy) halves[dy] = disk.half(dy);
        int taken = 0;
        for (int i = count - 1; i >= 0 && taken <= slots; --i) {
            const int place = (int)(unsigned)list[i], y = place / width, x = place - y * width;
            if (blocked[y * words + x / 32] >> (x % 32) & 1) continue;
            if (taken < slots) {
                u_out[taken] = x;
                v_out[taken] = y;
            }
            ++taken;
            const int top = y > reach ? y - reach : 0;
            const int bottom = y + reach < height ? y + reach : height - 1;
            for (int row = top; row <= bottom; ++row) {
                const int half = halves[row < y ? y - row : row - y];
                const int from = x > half ? x - half : 0;
                const int to = half < width - x ? x + half : width - 1;
                for (int w = from / 32; w <= to / 32; ++w)
                    blocked[row * words + w] |= PixelBits::part(w, from, to);
            }
        }
        for (int i = taken; i < slots; ++i) u_out[i] = v_out[i] = 0;
        return taken;
    }

    // By rising strength, and by place where equal, as the list is by place: radix sort, from the
    // lowest digit on.
    void sort() {
        unsigned least = 0xffffffffu, greatest = 0;
        for (int i = 0; i < count; ++i) {
            const unsigned bits = (unsigned)(list[i] >> 32);
            least = bits < least ? bits : least;
            greatest = bits > greatest ? bits : greatest;
        }
        for (int shift = 0; shift < 32 && count && (greatest - least) >> shift; shift += 8) {
            int bins[BINS + 1] = {};
            for (int i = 0; i < count; ++i) ++bins[digit(list[i], least, shift) + 1];
            for (int i = 1; i < BINS; ++i) bins[i] += bins[i - 1];
            for (int i = 0; i < count; ++i) other[bins[digit(list[i], least, shift)]++] = list[i];
            Key* swap = list;
            list = other;
            other = swap;
        }
    }

    static unsigned digit(Key key, unsigned least, int shift) {
        return ((unsigned)(key >> 32) - least) >> shift & (BINS - 1);
    }
};
#else
// A frame on CUDA, by a block of 1024 threads. The greedy rule has a parallel form: a corner is
// taken once no stronger one near it waits, and dropped as soon as a taken one is near. The result
// does not depend on the order of the steps.
struct CornerSelection {
    typedef unsigned long long Key;  // strength << 32 | place
    enum {
        THREADS = 1024,
        LIST = 4096,           // So many candidates are listed in shared memory,
        EACH = LIST / THREADS,
        NEAR = 16,             // if none has more stronger ones near it. Else bits are searched.
        DIGIT = 4,             // Bits of a round that looks for the weakest of the strongest.
    };

    int thread;
    int height, width;
    CornerDisk disk;
    double quality;            // Share of the strongest allowed strength that a corner exceeds.
    float strongest;           // That one, or 0.
    const float* strength;     // (height, width), at maxima.
    unsigned* maxima;          // (height, words), local maxima; those too weak are taken out.
    unsigned *open, *taken;    // Scratch: likewise.
    Key* keys;                 // Scratch: (the power of two that holds slots)
    int slots;
    int *u_out, *v_out;        // (slots), zero where there is no corner.
    int* count_out;            // How many corners there are, perhaps more than slots.

    // Shared by the threads.
    struct Shared {
        union {
            struct {
                int list[LIST], bits[LIST];  // Places and strengths; in the end
            };
            Key keys[LIST];                  // the keys of those kept.
        };
        int count, bins[1 << DIGIT];
        unsigned char state[LIST];
    };

    void run() const {
        __shared__ Shared shared;
        if (thread == 0) shared.count = 0;
        __syncthreads();
        gather(shared);
        __syncthreads();
        bool few = disk.limit > 0 && shared.count <= LIST;
        if (few) few = spread_listed(shared, shared.count);
        if (!few) spread_bits(shared);
        __syncthreads();
        const int found = shared.count;
        __syncthreads();
        keep_strongest(shared, few, found);
        __syncthreads();
        sort_and_write(shared, found < slots ? found : slots);
        if (thread == 0) *count_out = found;
    }

    int row_words() const { return PixelBits::words(width); }
    int size() const { return height * row_words(); }

    // Takes out maxima that are too weak, and lists the others; `open` says where in the list those
    // of a word begin.
    void gather(Shared& shared) const {
        const float limit = (float)((double)strongest * quality);
        const int words = row_words();
        for (int i = thread; i < size(); i += THREADS) {
            const unsigned all = maxima[i];
            if (all == 0) continue;
            const int y = i / words, first = y * width + (i - y * words) * 32;
            unsigned strong = 0;
            for (unsigned left = all; left; left &= left - 1) {
                const int bit = __ffs(left) - 1;
                if (strength[first + bit] > limit) strong |= 1u << bit;
            }
            if (strong != all) maxima[i] = strong;
            int at = atomicAdd(&shared.count, __popc(strong));
            open[i] = at;
            for (unsigned left = strong; left && at < LIST; left &= left - 1, ++at) {
                shared.list[at] = first + __ffs(left) - 1;
                shared.bits[at] = __float_as_int(strength[shared.list[at]]);
                shared.state[at] = 0;
            }
        }
    }

    // Of listed ones. False: too many are near each other, and nothing is done.
    bool spread_listed(Shared& shared, int corners) const {
        const int words = row_words(), reach = disk.reach();
        // The stronger ones near each candidate; of equals the last in raster order is stronger.
        unsigned short near[EACH][NEAR];
        int nears[EACH];
        bool too_many = false;
        #pragma unroll
        for (int k = 0; k < EACH; ++k) {
            nears[k] = 0;
            const int own = k * THREADS + thread;
            if (own >= corners) continue;
            const int place = shared.list[own], y = place / width, x = place - y * width;
            const float its_own = __int_as_float(shared.bits[own]);
            for (int v = max(y - reach, 0); v <= min(y + reach, height - 1); ++v) {
                const int half = disk.half(v - y);
                const int from = max(x - half, 0), to = min(x + half, width - 1);
                for (int w = from >> 5; w <= to >> 5; ++w) {
                    const unsigned word = maxima[v * words + w];
                    for (unsigned left = word & PixelBits::part(w, from, to); left;
                         left &= left - 1) {
                        const unsigned before = (left & -left) - 1;
                        const int other = (int)open[v * words + w] + __popc(word & before);
                        const float its = __int_as_float(shared.bits[other]);
                        if (!(its > its_own || (its == its_own && shared.list[other] > place)))
                            continue;
                        if (nears[k] == NEAR) {
                            too_many = true;
                            continue;
                        }
                        near[k][nears[k]++] = (unsigned short)other;
                    }
                }
            }
        }
        if (__syncthreads_or(too_many)) return false;
        // A state once set stays, so threads need not wait for each other: all that is read is
        // final or leads to another turn.
        enum { WAITS = 0, TAKEN = 1, DROPPED = 2 };
        volatile unsigned char* state = shared.state;
        int waiting = 0, took = 0;
        for (int k = 0; k < EACH; ++k)
            if (k * THREADS + thread < corners) waiting |= 1 << k;
        while (__syncthreads_or(waiting)) {
            #pragma unroll
            for (int k = 0; k < EACH; ++k) {
                if (!(waiting >> k & 1)) continue;
                int verdict = TAKEN;
                for (int i = 0; i < nears[k] && verdict != DROPPED; ++i) {
                    const int its = state[near[k][i]];
                    if (its == TAKEN) verdict = DROPPED;
                    if (its == WAITS) verdict = WAITS;
                }
                if (verdict == WAITS) continue;
                state[k * THREADS + thread] = (unsigned char)verdict;
                if (verdict == TAKEN) took |= 1 << k;
                waiting &= ~(1 << k);
            }
        }
        // The list is then of the taken ones.
        int places[EACH], strengths[EACH];
        for (int k = 0; k < EACH; ++k) {
            places[k] = shared.list[k * THREADS + thread];
            strengths[k] = shared.bits[k * THREADS + thread];
        }
        __syncthreads();
        if (thread == 0) shared.count = 0;
        __syncthreads();
        for (int k = 0; k < EACH; ++k) {
            if (!(took >> k & 1)) continue;
            const int at = atomicAdd(&shared.count, 1);
            shared.list[at] = places[k];
            shared.bits[at] = strengths[k];
        }
        return true;
    }

    // Of any number, as bits: a thread keeps words of the image.
    void spread_bits(Shared& shared) const {
        enum { KEPT = 16 };
        const bool spreads = disk.limit > 0;
        for (int i = thread; i < size(); i += THREADS) {
            open[i] = spreads ? maxima[i] : 0;
            taken[i] = spreads ? 0 : maxima[i];
        }
        __syncthreads();
        int more = spreads;
        while (__syncthreads_or(more)) {
            more = 0;
            for (int base = 0; base < size(); base += THREADS * KEPT) {
                unsigned accept[KEPT], reject[KEPT];
                for (int k = 0; k < KEPT; ++k) {
                    const int i = base + k * THREADS + thread;
                    accept[k] = reject[k] = 0;
                    if (i >= size()) continue;
                    for (unsigned left = open[i]; left; left &= left - 1) {
                        const int bit = __ffs(left) - 1, verdict = decide(i, bit);
                        if (verdict > 0) accept[k] |= 1u << bit;
                        if (verdict < 0) reject[k] |= 1u << bit;
                    }
                }
                __syncthreads();
                for (int k = 0; k < KEPT; ++k) {
                    const int i = base + k * THREADS + thread;
                    if (i >= size()) continue;
                    taken[i] |= accept[k];
                    open[i] &= ~(accept[k] | reject[k]);
                    if (open[i]) more = 1;
                }
                __syncthreads();
            }
        }
        if (thread == 0) shared.count = 0;
        __syncthreads();
        int own = 0;
        for (int i = thread; i < size(); i += THREADS) own += __popc(taken[i]);
        atomicAdd(&shared.count, own);
    }

    // 1 takes the corner, -1 drops it, 0 waits.
    int decide(int i, int bit) const {
        const int words = row_words(), reach = disk.reach();
        const int y = i / words, x = (i - y * words) * 32 + bit, place = y * width + x;
        const float own = strength[place];
        bool waits = false;
        for (int v = max(y - reach, 0); v <= min(y + reach, height - 1); ++v) {
            const int half = disk.half(v - y);
            const int from = max(x - half, 0), to = min(x + half, width - 1);
            for (int w = from >> 5; w <= to >> 5; ++w) {
                const unsigned in = PixelBits::part(w, from, to);
                if (taken[v * words + w] & in) return -1;
                for (unsigned left = open[v * words + w] & in; left && !waits; left &= left - 1) {
                    const int other = v * width + w * 32 + __ffs(left) - 1;
                    waits = strength[other] > own || (strength[other] == own && other > place);
                }
            }
        }
        return waits ? 0 : 1;
    }

    Key key_of(int bits, int place) const { return (Key)(unsigned)bits << 32 | (unsigned)place; }

    // Of the corners taken the strongest, as many as there are slots for, become `keys`, in no
    // order.
    void keep_strongest(Shared& shared, bool few, int found) const {
        Key least = 0;
        if (found > slots) {
            // Radix selection of the weakest of them, from the highest digit on.
            int wanted = slots;
            for (int shift = 64 - DIGIT; shift >= 0; shift -= DIGIT) {
                if (thread < 1 << DIGIT) shared.bins[thread] = 0;
                __syncthreads();
                const Key known = shift == 64 - DIGIT ? 0 : ~(Key)0 << (shift + DIGIT);
                each(shared, few, found, least, known, shift, true);
                __syncthreads();
                int digit = (1 << DIGIT) - 1;
                while (digit > 0 && shared.bins[digit] < wanted) wanted -= shared.bins[digit--];
                least |= (Key)digit << shift;
                __syncthreads();
            }
        }
        if (thread == 0) shared.count = 0;
        __syncthreads();
        each(shared, few, found, least, 0, 0, false);
    }

    // Counts the digits of the corners that begin as `least` does, or keeps those that are not less.
    void each(Shared& shared, bool few, int found, Key least, Key known, int shift,
              bool counts) const {
        if (few) {
            for (int k = thread; k < found; k += THREADS)
                use(shared, key_of(shared.bits[k], shared.list[k]), least, known, shift, counts);
            return;
        }
        const int words = row_words();
        for (int i = thread; i < size(); i += THREADS)
            for (unsigned left = taken[i]; left; left &= left - 1) {
                const int place = i / words * width + i % words * 32 + __ffs(left) - 1;
                use(shared, key_of(__float_as_int(strength[place]), place), least, known, shift,
                    counts);
            }
    }

    void use(Shared& shared, Key key, Key least, Key known, int shift, bool counts) const {
        if (!counts) {
            if (key >= least) keys[atomicAdd(&shared.count, 1)] = key;
        } else if ((key & known) == (least & known)) {
            atomicAdd(&shared.bins[key >> shift & ((1 << DIGIT) - 1)], 1);
        }
    }

    // Sorts so many keys, greatest first, by exchanging pairs (a bitonic network).
    void sort_and_write(Shared& shared, int count) const {
        int padded = 1;
        while (padded < count) padded *= 2;
        Key* sorted = keys;
        if (padded <= LIST) {
            sorted = shared.keys;
            for (int i = thread; i < count; i += THREADS) sorted[i] = keys[i];
        }
        for (int i = count + thread; i < padded; i += THREADS) sorted[i] = 0;
        for (int run = 2; run <= padded; run *= 2)
            for (int away = run / 2; away; away /= 2) {
                __syncthreads();
                for (int i = thread; i < padded / 2; i += THREADS) {
                    const int a = 2 * i - (i & (away - 1)), b = a + away;
                    const Key first = sorted[a], second = sorted[b];
                    if ((first < second) == ((a & run) == 0)) {
                        sorted[a] = second;
                        sorted[b] = first;
                    }
                }
            }
        __syncthreads();
        for (int i = thread; i < slots; i += THREADS) {
            const int place = i < count ? (int)(unsigned)sorted[i] : 0;
            u_out[i] = place % width;
            v_out[i] = place / width;
        }
    }
};
#endif

} }  // namespace jaxdet
