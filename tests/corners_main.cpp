// The corners of one image, as the CPU kernel finds them: tests/test_native.py runs it under
// sanitizers. The file named has height, width, slots, the settings, colours and mask.
#include <cstdio>
#include <vector>

#include "canny.h"
#include "corner_maxima.h"
#include "corner_selection.h"
#include "corner_settings.h"
#include "hysteresis.h"
#include "mask_bits.h"

int main(int, char** arguments) {
    int head[3], values[CornerSettings::COUNT];
    FILE* file = fopen(arguments[1], "rb");
    bool is_whole = file && fread(head, sizeof head, 1, file) == 1;
    is_whole = is_whole && fread(values, sizeof values, 1, file) == 1;
    if (!is_whole) return 1;
    const int height = head[0], width = head[1], slots = head[2];
    const size_t pixels = (size_t)height * width;
    const size_t words = (size_t)height * PixelBits::words(width);
    // Each on its own, so that what lies outside of it is nobody's.
    std::vector<unsigned char> color(3 * pixels), mask(pixels);
    std::vector<unsigned long long> list(pixels), other(pixels);
    std::vector<unsigned long long> bits[5];
    for (auto& image : bits) image.assign(words / 2, ~0ull);
    unsigned* rows[5];
    for (int i = 0; i < 5; ++i) rows[i] = (unsigned*)bits[i].data();
    if (fread(color.data(), color.size(), 1, file) != 1) return 1;
    if (fread(mask.data(), mask.size(), 1, file) != 1) return 1;
    fclose(file);

    const CornerSettings given{values};
    const Team team(0, 0);
    MaskBits{team, height, width, (const bool*)mask.data(), rows[0]}.run();
    CannySuppress{color.data(), height, width, given.low(), given.high(), rows[1], rows[2]}.run();
    Hysteresis{team, height, width, rows[1], rows[2], rows[3]}.run();
    const int count = CornerMaxima{rows[3], rows[0], given.everywhere(), height, width,
                                   given.quality(), list.data()}.run();
    std::vector<int> u(slots), v(slots);
    const int found = CornerSelection{height, width, CornerDisk{given.limit()}, slots, list.data(),
                                      other.data(), count, rows[4], u.data(), v.data()}.run();
    printf("%d\n", found);
    for (int i = 0; i < slots; ++i) printf("%d %d\n", u[i], v[i]);
    return 0;
}
