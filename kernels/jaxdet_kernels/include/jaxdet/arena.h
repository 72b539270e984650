// Bump allocator for scratch memory; each array begins at a cache line.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct Arena {
    enum { LINE = 16 };
    int* base;        // start of the memory
    int used = 0;     // allocated words

    // Returns an arena that only counts words: its memory is neither read nor written.
    static Arena counting() { return {(int*)(LINE * sizeof(int))}; }

    int* words(int count) {
        int* place = base + used;
        used += (count + LINE - 1) / LINE * LINE;
#if !defined(__CUDA_ARCH__)
        // Hides the distance between arrays from clang, which would otherwise try to exploit it in
        // every loop: that takes four times as long to compile and is no faster.
        asm("" : "+r"(place));
#endif
        return place;
    }
    unsigned long long* longs(int count) { return (unsigned long long*)words(2 * count); }
};

// Allocates several arrays of `words` words each.
template <class... Arrays> void take(Arena& arena, int words, Arrays*&... all) {
    ((all = (Arrays*)arena.words(words)), ...);
}

} }  // namespace jaxdet
