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
    // Allocates several arrays of `count` words each.
    template <class... Arrays> void take(int count, Arrays*&... all) {
        ((all = (Arrays*)words(count)), ...);
    }
};

} }  // namespace jaxdet
