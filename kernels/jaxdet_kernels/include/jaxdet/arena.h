// Hands out scratch memory in the order of requests, each at a cache line.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct Arena {
    enum { LINE = 16 };
    int* base;        // where it begins
    int used = 0;     // words

    // One that only counts: nothing is read or written there.
    static Arena counting() { return {(int*)(LINE * sizeof(int))}; }

    int* words(int count) {
        int* place = base + used;
        used += (count + LINE - 1) / LINE * LINE;
#if !defined(__CUDA_ARCH__)
        // Hides from clang how far one array is from another, which it would try to make use of in
        // every loop: that takes four times as long to compile and is no faster.
        asm("" : "+r"(place));
#endif
        return place;
    }
    unsigned long long* longs(int count) { return (unsigned long long*)words(2 * count); }
};

// Takes arrays of so many words each from an arena.
template <class... Arrays> void take(Arena& arena, int words, Arrays*&... all) {
    ((all = (Arrays*)arena.words(words)), ...);
}

} }  // namespace jaxdet
