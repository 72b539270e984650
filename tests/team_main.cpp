// A kernel of a team of threads as CUDA has it, by threads that take turns (tests/simt.h), for
// tests/test_native_teams.py: `kernel.h` has the structs, the arrays as globals of `teams` and the
// kernel. The file named has all arrays; those from the first result on are written back.
#include "simt.h"

#include <stddef.h>

#include <initializer_list>

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

template <class T> struct Array {
    std::vector<unsigned char> bytes;
    T* data;
    int shape[5];

    void load(FILE* file, std::initializer_list<int> sizes) {
        size_t count = 1;
        std::copy(sizes.begin(), sizes.end(), shape);
        for (int size : sizes) count *= size;
        bytes.resize(count * sizeof(T) + 64);
        data = (T*)(bytes.data() + (-(size_t)bytes.data() & 63));
        if (fread(data, sizeof(T), count, file) != count) Simt::fail("the file is too short");
        bytes.resize(count * sizeof(T) + 64);
    }
    void store(FILE* file) const { fwrite(data, 1, bytes.size() - 64, file); }
};

#include "kernel.h"

int main(int, char** argv) {
    FILE* file = fopen(argv[1], "rb");
    teams::load(file);
    fclose(file);
    // Two teams, so that one has frames and the other may have none.
    for (int team = 0; team < 2; ++team)
        Simt::one().run(256, [team] { teams::kernel(threadIdx.x, team, 2); });
    file = fopen(argv[1], "wb");
    teams::store(file);
    fclose(file);
}
