"""The depth ranges that ``align_search`` reads, on the CPU: C++ for native functions."""

from jaxdet_kernels.align_search import TILE

RANGES = """
    // Nearest depth << 16 | farthest of each tile and of the frame; 65535 << 16 where none.
    {
        typedef unsigned short lanes __attribute__((ext_vector_type(32), aligned(2)));
        const int Hd = depth.shape[1], Wd = depth.shape[2], across = tiles.shape[2];
        unsigned frame_least = 65535, frame_most = 0;
        for (int i = 0; i < tiles.shape[1]; ++i) {
            const int y0 = i * TILE, y1 = y0 + TILE < Hd ? y0 + TILE : Hd;
            const unsigned short* rows = depth.data + ((size_t)b * Hd + y0) * Wd;
            unsigned* out = tiles.data + ((size_t)b * tiles.shape[1] + i) * across;
            auto note = [&](int j, unsigned short least, unsigned short most) {
                const unsigned nearest = least == 65535 ? 65535u : least + 1u;
                out[j] = (nearest << 16) | most;
                if (nearest < frame_least) frame_least = nearest;
                if (most > frame_most) frame_most = most;
            };
            int j = 0;
            for (; (j + 2) * TILE <= Wd; j += 2) {
                lanes least = (lanes)(unsigned short)65535, most = (lanes)(unsigned short)0;
                for (int y = 0; y < y1 - y0; ++y) {
                    const lanes units = *(const lanes*)(rows + (size_t)y * Wd + j * TILE);
                    // No measurement, 0, wraps to the largest number.
                    least = __builtin_elementwise_min(least, units - (unsigned short)1);
                    most = __builtin_elementwise_max(most, units);
                }
                note(j, __builtin_reduce_min(least.lo), __builtin_reduce_max(most.lo));
                note(j + 1, __builtin_reduce_min(least.hi), __builtin_reduce_max(most.hi));
            }
            for (; j < across; ++j) {
                unsigned short least = 65535, most = 0;
                for (int y = 0; y < y1 - y0; ++y)
                    for (int x = j * TILE; x < (j + 1) * TILE && x < Wd; ++x) {
                        const unsigned short units = rows[(size_t)y * Wd + x];
                        const unsigned short less = (unsigned short)(units - 1);
                        least = less < least ? less : least;
                        most = units > most ? units : most;
                    }
                note(j, least, most);
            }
        }
        ranges.data[b] = (frame_least << 16) | frame_most;
    }
""".replace("TILE", str(TILE))
