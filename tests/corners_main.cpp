// The corners of one image as the kernels find them, on the CPU or, with SIMT defined, by the code
// for CUDA: tests/test_native.py runs both. The file named has height, width, slots, the settings,
// colours and mask.
#if defined(SIMT)
#include "simt.h"
#endif

#include <cstdio>
#include <vector>

#include "jaxdet/canny.h"
#include "jaxdet/corner_maxima.h"
#include "jaxdet/corner_selection.h"
#include "jaxdet/corner_settings.h"
#include "jaxdet/hysteresis.h"

using namespace jaxdet;

struct Image {
    int height, width, slots;
    CornerSettings given;
    // Each on its own, so that what lies outside of it is nobody's.
    std::vector<unsigned char> color, mask;
    std::vector<unsigned long long> bits[7];
    std::vector<int> u, v;

    unsigned* rows(int i) { return (unsigned*)bits[i].data(); }
    size_t pixels() const { return (size_t)height * width; }
};

#if defined(SIMT)
int corners(Image& image) {
    const int height = image.height, width = image.width, slots = image.slots;
    const CornerSettings& given = image.given;
    unsigned *allowed = image.rows(0), *weak = image.rows(1), *strong = image.rows(2);
    unsigned *edges = image.rows(3), *maxima = image.rows(4);
    Simt& simt = Simt::one();
    typedef CannySuppressTile Tile;
    for (int top = 0; top < height; top += Tile::ROWS)
        for (int left = 0; left < width; left += Tile::COLUMNS)
            simt.run(Tile::THREADS, [&] {
                Tile{threadIdx.x, image.color.data(), height, width, top, left, given.low(),
                     given.high(), weak, strong}.run();
            });
    simt.run(512, [&] {
        const Team team(threadIdx.x, 0);
        Hysteresis{team, height, width, weak, strong, edges}.run();
    });
    std::vector<float> strength(image.pixels(), 1e30f);
    int strongest = 0;
    for (auto& word : image.bits[4]) word = 0;
    for (int top = 0; top < height; top += CornerTile::ROWS)
        for (int left = 0; left < width; left += CornerTile::COLUMNS)
            simt.run(CornerTile::THREADS, [&] {
                CornerTile{threadIdx.x, edges, allowed, given.everywhere(), height, width, top,
                           left, strength.data(), maxima, &strongest}.run();
            });
    int power = 1, found = -1;
    while (power < slots) power *= 2;
    std::vector<unsigned long long> keys(power, ~0ull);
    simt.run(CornerSelection::THREADS, [&] {
        CornerSelection{threadIdx.x, height, width, CornerDisk{given.limit()}, given.quality(),
                        __int_as_float(strongest), strength.data(), maxima, image.rows(5),
                        image.rows(6), keys.data(), slots, image.u.data(), image.v.data(),
                        &found}.run();
    });
    return found;
}
#else
int corners(Image& image) {
    const int height = image.height, width = image.width;
    const CornerSettings& given = image.given;
    unsigned *allowed = image.rows(0), *edges = image.rows(3), *blocked = image.rows(4);
    std::vector<unsigned long long> memory[2];
    for (auto& words : memory) words.assign(Hysteresis::spaced(height, width), ~0ull);
    auto *weak = Hysteresis::rows(memory[0].data(), height, width);
    auto *strong = Hysteresis::rows(memory[1].data(), height, width);
    CannySuppress{image.color.data(), height, width, given.low(), given.high(),
                  2 * Hysteresis::stride(width), (unsigned*)weak, (unsigned*)strong}.run();
    Hysteresis{height, width, weak, strong, edges}.run();
    std::vector<unsigned long long> list(image.pixels()), other(image.pixels());
    const int count = CornerMaxima{edges, allowed, given.everywhere(), height, width,
                                   given.quality(), list.data()}.run();
    return CornerSelection{height, width, CornerDisk{given.limit()}, image.slots, list.data(),
                           other.data(), count, blocked, image.u.data(), image.v.data()}.run();
}
#endif

int main(int, char** arguments) {
    int head[3], values[CornerSettings::COUNT];
    FILE* file = fopen(arguments[1], "rb");
    bool is_whole = file && fread(head, sizeof head, 1, file) == 1;
    is_whole = is_whole && fread(values, sizeof values, 1, file) == 1;
    if (!is_whole) return 1;
    Image image = {head[0], head[1], head[2], {values}, {}, {}, {}, {}, {}};
    image.color.resize(3 * image.pixels());
    image.mask.resize(image.pixels());
    // What memory holds before must not matter.
    for (auto& bits : image.bits)
        bits.assign((size_t)image.height * PixelBits::words(image.width) / 2, ~0ull);
    image.u.assign(image.slots, -1);
    image.v.assign(image.slots, -1);
    if (fread(image.color.data(), image.color.size(), 1, file) != 1) return 1;
    if (fread(image.mask.data(), image.mask.size(), 1, file) != 1) return 1;
    fclose(file);
    for (auto& word : image.bits[0]) word = 0;
    for (size_t i = 0; i < image.pixels(); ++i) {
        const int y = (int)i / image.width, x = (int)i % image.width;
        unsigned* row = image.rows(0) + (size_t)y * PixelBits::words(image.width);
        row[x / 32] |= (unsigned)(image.mask[i] != 0) << x % 32;
    }
    printf("%d\n", corners(image));
    for (int i = 0; i < image.slots; ++i) printf("%d %d\n", image.u[i], image.v[i]);
    return 0;
}
