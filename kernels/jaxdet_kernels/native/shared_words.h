// Memory that the threads of a block share on CUDA, for one use after the other.
#pragma once
#include "team.h"

struct SharedWords {
    enum { COUNT = 8192 };

#if defined(__CUDA_ARCH__)
    // Between two uses all threads must wait.
    static int* begin() {
        __shared__ int words[COUNT];
        return words;
    }
#endif
};
