// Runs a step of the program for tests/test_native_teams.py: in one thread as on the CPU or, with
// SIMT defined, in teams of CUDA threads that take turns (tests/simt.h). The argument is a file
// with the step, the lengths of the arrays in bytes and the arrays; record, contours and work are
// written back to it.
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

#include <vector>

#if defined(SIMT)
#include "simt.h"
#endif

#include "jaxdet/program.h"

using namespace jaxdet;

int main(int, char** argv) {
    enum { DEPTH, FLOORS, TABLES, RECORD, CONTOUR, WORK, ARRAYS, TEAMS = 2 };
    int head[6], sizes[ARRAYS];
    FILE* file = fopen(argv[1], "rb");
    if (fread(head, sizeof head, 1, file) != 1 || fread(sizes, sizeof sizes, 1, file) != 1) abort();
    const int step = head[0], frames = head[1], pixels = head[2];
    const int rows = head[3], columns = head[4], words = head[5];
    // Separate allocations, so that sanitizers detect accesses outside of an array.
    std::vector<unsigned char> arrays[ARRAYS];
    std::vector<int> scratch((size_t)TEAMS * words);
    for (int i = 0; i < ARRAYS; ++i) {
        arrays[i].resize(sizes[i]);
        if (fread(arrays[i].data(), 1, sizes[i], file) != (size_t)sizes[i]) abort();
    }
    fclose(file);
    const auto of = [&](int i) { return (int*)arrays[i].data(); };
    const auto row = [&](int i) { return sizes[i] / (int)sizeof(int) / frames; };
    const Batch batch{(const unsigned short*)of(DEPTH), of(FLOORS), of(TABLES), of(RECORD),
                      of(CONTOUR), of(WORK), frames, pixels, row(RECORD), row(CONTOUR), row(WORK),
                      rows, columns};
#if defined(SIMT)
    typedef void (Frame::*Step)(const Team&, int*) const;
    const Step steps[] = {&Frame::find_cells, &Frame::find_floor, &Frame::find_frame,
                          &Frame::find_surfaces, &Frame::find_obstacles, &Frame::find_free_floor,
                          &Frame::find_outlines};
    for (int team = 0; team < TEAMS; ++team)
        Simt::one().run(256, [&, team] {
            batch.by_teams(256 * team + threadIdx.x, TEAMS, scratch.data(), words,
                           [&](const Frame& frame, const Team& own, int* memory) {
                               (frame.*steps[step])(own, memory);
                           });
        });
#else
    int next = 0;
    batch.by_threads(&next, step, step, scratch.data());
#endif
    file = fopen(argv[1], "wb");
    for (int i = RECORD; i < ARRAYS; ++i) fwrite(of(i), 1, sizes[i], file);
    fclose(file);
}
