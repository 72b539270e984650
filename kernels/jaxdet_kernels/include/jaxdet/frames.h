// How threads of the CPU share the frames of a batch.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

#if !defined(__CUDA_ARCH__)
// Does `work(b)` for frames that no other thread has taken, until there are none; `next` is the
// first of those. One launch for all: after a launch a thread of Python would wait for its lock.
template <class Work> void each_frame(int* next, int frames, Work work) {
    for (;;) {
        const int b = __atomic_fetch_add(next, 1, __ATOMIC_RELAXED);
        if (b >= frames) return;
        work((size_t)b);
    }
}
#endif

} }  // namespace jaxdet
