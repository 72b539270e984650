// All kernels of a program on a frame, then on the next one that no thread has taken, by a thread of
// the CPU. jaxdet/stages/_chain.py makes the tables.
#pragma once
#include "team.h"

namespace jaxdet {
namespace {

#if !defined(__CUDA_ARCH__)
struct FrameLoop {
    typedef unsigned long long Address;
    typedef void (*Kernel)(Address size, Address arguments);

    // Of each kernel its code, the size of its launch, its arguments, and where in `words` these are.
    enum { CODE, SIZE, ARGUMENTS, WORD, FIELDS };
    const Address* kernels;  // (count, FIELDS)
    int count;
    Address* words;          // The arguments of all kernels; of each the first is the frame, an int.
    // Of memory with room for one frame: which word says where it is, where, and a frame's bytes.
    enum { PLACE, BEGIN, ROW, VALUES };
    const Address* rooms;    // (num_rooms, VALUES)
    int num_rooms;
    int* next;               // The first frame that no thread has taken.
    int frames;

    void run() const {
        while (true) {
            const int frame = __atomic_fetch_add(next, 1, __ATOMIC_RELAXED);
            if (frame >= frames) return;
            for (int k = 0; k < count; ++k) *(int*)&words[kernels[k * FIELDS + WORD]] = frame;
            // A kernel adds the rows of the frames before.
            for (const Address* room = rooms; room < rooms + num_rooms * VALUES; room += VALUES)
                words[room[PLACE]] = room[BEGIN] - frame * room[ROW];
            for (const Address* one = kernels; one < kernels + count * FIELDS; one += FIELDS)
                ((Kernel)one[CODE])(one[SIZE], one[ARGUMENTS]);
        }
    }
};
#endif

}  // namespace
}  // namespace jaxdet
