// A step of the program by teams of threads as CUDA has them, which take turns (tests/simt.h), for
// tests/test_native_teams.py. The file named has the step, the lengths of the arrays in bytes and
// the arrays; record, contours and work are written back.
#include "simt.h"

#include <stddef.h>

template <class Combine> int reduced(const char* kind, int mine, Combine combine) {
    const auto& all = Simt::one().warp(kind, as_word(mine));
    int found = from_word<int>(all[0]);
    for (int i = 1; i < 32; ++i) found = combine(found, from_word<int>(all[i]));
    return found;
}
inline int __reduce_add_sync(unsigned mask, int mine) {
    whole(mask);
    return reduced("add", mine, [](int a, int b) { return (int)((unsigned)a + (unsigned)b); });
}
inline int __reduce_min_sync(unsigned mask, int mine) {
    whole(mask);
    return reduced("min", mine, [](int a, int b) { return a < b ? a : b; });
}
inline int __clz(int v) { return v ? __builtin_clz(v) : 32; }

#include "jaxdet/program.h"

using namespace jaxdet;

int main(int, char** argv) {
    enum { DEPTH, FLOORS, TABLES, RECORD, CONTOUR, WORK, ARRAYS, TEAMS = 2 };
    int head[4], sizes[ARRAYS];
    FILE* file = fopen(argv[1], "rb");
    if (fread(head, sizeof head, 1, file) != 1 || fread(sizes, sizeof sizes, 1, file) != 1)
        Simt::fail("no head");
    const int step = head[0], frames = head[1], pixels = head[2], words = head[3];
    std::vector<unsigned long long> arrays[ARRAYS], scratch((size_t)TEAMS * words / 2);
    for (int i = 0; i < ARRAYS; ++i) {
        arrays[i].resize(sizes[i] / 8 + 1);
        if (fread(arrays[i].data(), 1, sizes[i], file) != (size_t)sizes[i])
            Simt::fail("the file is too short");
    }
    fclose(file);
    const auto of = [&](int i) { return (int*)arrays[i].data(); };
    const auto row = [&](int i) { return sizes[i] / (int)sizeof(int) / frames; };
    const Batch batch{(const unsigned short*)of(DEPTH), of(FLOORS), of(TABLES), of(RECORD),
                      of(CONTOUR), of(WORK), frames, pixels, row(RECORD), row(CONTOUR), row(WORK)};
    typedef void (Frame::*Step)(const Team&, int*) const;
    const Step steps[] = {&Frame::find_cells, &Frame::find_floor, &Frame::find_frame,
                          &Frame::find_surfaces, &Frame::find_obstacles, &Frame::find_outlines,
                          &Frame::find_free_floor};
    for (int team = 0; team < TEAMS; ++team)
        Simt::one().run(256, [&, team] {
            batch.by_teams(256 * team + threadIdx.x, TEAMS, (int*)scratch.data(), words,
                           [&](const Frame& frame, const Team& own, int* memory) {
                               (frame.*steps[step])(own, memory);
                           });
        });
    file = fopen(argv[1], "wb");
    for (int i = RECORD; i < ARRAYS; ++i) fwrite(of(i), 1, sizes[i], file);
    fclose(file);
}
