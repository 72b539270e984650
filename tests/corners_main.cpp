// Prints the corners that the kernels find in an image, on the CPU or, with SIMT defined, by an
// emulated CUDA block; tests/test_native.py runs both. The argument is a file with height, width,
// slots, settings and colours.
#if defined(SIMT)
#include "simt.h"
#endif

#include <cstdio>
#include <vector>

#include "jaxdet/corners.h"

using namespace jaxdet;

int main(int, char** arguments) {
    int head[3], found = -1;
    CornerSettings settings;
    FILE* file = fopen(arguments[1], "rb");
    bool is_whole = file && fread(head, sizeof head, 1, file) == 1;
    is_whole = is_whole && fread(&settings, sizeof settings, 1, file) == 1;
    if (!is_whole) return 1;
    const int height = head[0], width = head[1], slots = head[2];
    const size_t pixels = (size_t)height * width;
    std::vector<unsigned char> color(3 * pixels);
    if (fread(color.data(), color.size(), 1, file) != 1) return 1;
    fclose(file);
    // Filled, as results must not depend on earlier contents. Words are aligned as in the kernels.
    std::vector<unsigned long long> scratch(Corners::scratch_words(height, width) / 2, ~0ull);
    std::vector<int> u(slots, -1), v(slots, -1);
    static Corners::Shared shared;
    const auto run = [&](const Team& team) {
        Corners{height, width, settings, slots}.run(team, shared, color.data(),
                                                    (int*)scratch.data(), u.data(), v.data(),
                                                    &found);
    };
#if defined(SIMT)
    Simt::one().run(256, [&] { run(Team(threadIdx.x, 0)); });
#else
    run(Team(0, 0));
#endif
    printf("%d\n", found);
    for (int i = 0; i < slots; ++i) printf("%d %d\n", u[i], v[i]);
    return 0;
}
