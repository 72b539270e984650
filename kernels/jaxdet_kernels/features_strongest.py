"""The strongest N of the corners that ``features_select`` has taken; C++ that ends its kernel."""

STRONGEST = """
    // Keep the strongest N: a radix search for the N-th key (strength, place), 4 bits a round.
    typedef unsigned long long u64;
    __shared__ int bins[16];
    auto each_key = [&](auto use) {
        auto key_of = [&](int strength, int place) -> u64 {
            const unsigned ordered = strength < 0 ? ~strength : strength | 0x80000000;
            return ((u64)ordered << 32) | (unsigned)place;
        };
        if (few) {
            for (int k = thread; k < found; k += 1024) use(key_of(bits[k], list[k]));
            return;
        }
        for (int i = thread; i < size; i += 1024)
            for (unsigned left = taken[i]; left; left &= left - 1) {
                const int place = i / words * W + (i % words) * 32 + __ffs(left) - 1;
                use(key_of(__float_as_int(e[place]), place));
            }
    };
    u64 least = 0;
    if (found > N) {
        int wanted = N;
        for (int shift = 60; shift >= 0; shift -= 4) {
            if (thread < 16) bins[thread] = 0;
            __syncthreads();
            const u64 known = shift == 60 ? 0 : ~(u64)0 << (shift + 4);
            each_key([&](u64 key) {
                if ((key & known) == (least & known)) atomicAdd(&bins[(key >> shift) & 15], 1);
            });
            __syncthreads();
            int digit = 15;
            while (digit > 0 && bins[digit] < wanted) wanted -= bins[digit--];
            least |= (u64)digit << shift;
            __syncthreads();
        }
    }
    if (thread == 0) { count = 0; found_out.data[block] = found; }
    __syncthreads();
    each_key([&](u64 key) {
        if (key < least) return;
        const int at = atomicAdd(&count, 1);
        // Complemented, so that a rising sort is strongest first, then last place first.
        strength_key_out.data[(size_t)block * N + at] = ~(unsigned)(key >> 32);
        place_key_out.data[(size_t)block * N + at] = ~(unsigned)key;
    });
    __syncthreads();
    for (int at = count + thread; at < N; at += 1024) {
        strength_key_out.data[(size_t)block * N + at] = 0xffffffffu;
        place_key_out.data[(size_t)block * N + at] = 0xffffffffu;
    }
#endif
"""
