"""Sets of linked points that leave tall surfaces apart: union-find with the smaller root.

Twin of ``jaxdet/reference/_slices.py``, from links that are found already. A root is always the
smallest node of its component, and surfaces are given away a link farther in each round, so the
result does not depend on the order in which links are taken. On CUDA a block does a frame with its
forest in shared memory and joins roots by compare-and-swap, which only ever hangs a root below a
smaller node; on the CPU a thread does a frame.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

LINKED_SETS_BLOCK = 512
"""Threads of a block on CUDA."""

_HEAD = """
    const int N = links.shape[2], BEHIND = 2;
#if defined(__CUDA_ARCH__)
    const int b = tid / 512, thread = tid % 512, step = 512;
    __shared__ int parent[8192];
    __shared__ int columns, tall;
    #define WAIT() __syncthreads()
    #define ANY(flag) __syncthreads_or(flag)
    #define HANG(high, low) atomicCAS(&parent[high], high, low)
    #define LEAST(place, value) atomicMin(place, value)
    #define MOST(place, value) atomicMax(place, value)
    #define COUNT(place) atomicAdd(place, 1)
#else
    const int b = tid, thread = 0, step = 1;
    int parent[8192], columns, tall;
    #define WAIT()
    #define ANY(flag) (flag)
    #define HANG(high, low) (parent[high] = low, high)
    #define LEAST(place, value) (*(place) = *(place) < (value) ? *(place) : (value))
    #define MOST(place, value) (*(place) = *(place) > (value) ? *(place) : (value))
    #define COUNT(place) (++*(place))
#endif
    const int* other = links.data + (size_t)b * 3 * N;
    const int* depth = z.data + (size_t)b * N;
    const int* down = y.data + (size_t)b * N;
    const int* row = v.data + (size_t)b * N;
    const unsigned char* keep = (const unsigned char*)kept.data + (size_t)b * N;
    volatile int* top = scratch_out.data + (size_t)b * 2 * N;
    volatile int* bottom = top + N;
    // Whose a surface is, by its root: how many links away, and the owner.
    volatile int* owner = top;
    const int nobody = 1 << 30;
    int* out = root_out.data + (size_t)b * N;
    auto find = [&](int i) -> int {
        volatile int* up = parent;
        int above = up[i];
        while (above != i) {
            const int next = up[above];
            up[i] = next;
            i = above;
            above = next;
        }
        return i;
    };
    auto link = [&](int one, int two) {
        while (true) {
            one = find(one);
            two = find(two);
            if (one == two) return;
            const int high = one > two ? one : two, low = one > two ? two : one;
            if (HANG(high, low) == high) return;
        }
    };
    for (int i = thread; i < N; i += step) parent[i] = i;
    if (thread == 0) { columns = N; tall = 0; }
    WAIT();
    for (int i = thread; i < N; i += step)
        if (other[BEHIND * N + i] >= 0) link(i, other[BEHIND * N + i]);
"""

_SURFACES = """
    for (int i = first_grid + thread; i < N; i += step)
        if (row[i] != row[first_grid]) LEAST(&columns, i - first_grid);
    WAIT();
    for (int i = first_grid + thread; i < N; i += step) {
        if (!keep[i]) continue;
        for (int up = 0; up < 2; ++up) {
            const int j = up ? i - columns : i - 1;
            if (j < first_grid || !keep[j] || (!up && row[i] != row[j])) continue;
            const int most = gaps.data[depth[i] < depth[j] ? depth[i] : depth[j]];
            const int ahead = depth[i] - depth[j];
            if (ahead <= most && -ahead <= most) link(i, j);
        }
    }
    WAIT();
    // From here on every point knows its surface.
    for (int i = thread; i < N; i += step) {
        top[i] = 1 << 20;
        bottom[i] = -(1 << 20);
    }
    for (int i = thread; i < N; i += step) out[i] = find(i);
    WAIT();
    for (int i = first_grid + thread; i < N; i += step) {
        if (!keep[i]) continue;
        LEAST((int*)&top[out[i]], down[i]);
        MOST((int*)&bottom[out[i]], down[i]);
    }
    WAIT();
    for (int i = thread; i < N; i += step) {
        const bool stands = out[i] == i && bottom[i] - top[i] >= tall_units;
        if (stands) COUNT(&tall);
        owner[i] = stands ? i : nobody;
    }
    WAIT();
"""

_APART = """
    for (int round = 1, more = 1; more; ++round) {
        more = 0;
        for (int k = thread; k < BEHIND * N; k += step) {
            if (other[k] < 0) continue;
            const int ends[2] = {out[k < N ? k : k - N], out[other[k]]};
            if (ends[0] == ends[1]) continue;
            for (int way = 0; way < 2; ++way) {
                const int from = owner[ends[way]], to = ends[1 - way];
                const int offer = round << 13 | (from & 8191);
                if (from >> 13 >= round || owner[to] <= offer) continue;
                LEAST((int*)&owner[to], offer);
                more = 1;
            }
        }
        more = ANY(more);
    }
    for (int k = thread; k < BEHIND * N; k += step) {
        if (other[k] < 0) continue;
        const int one = out[k < N ? k : k - N], two = out[other[k]];
        if (one != two && owner[one] == nobody && owner[two] == nobody) link(one, two);
    }
    WAIT();
    // A set's number is its smallest point.
    for (int i = thread; i < N; i += step) bottom[i] = N;
    WAIT();
    for (int i = thread; i < N; i += step) {
        const int mine = owner[out[i]], set = mine == nobody ? find(out[i]) : mine & 8191;
        out[i] = set;
        LEAST((int*)&bottom[set], i);
    }
    WAIT();
    for (int i = thread; i < N; i += step) out[i] = bottom[out[i]];
"""

_WHOLE = """
    for (int k = thread; k < BEHIND * N; k += step)
        if (other[k] >= 0) link(k < N ? k : k - N, other[k]);
    WAIT();
    for (int i = thread; i < N; i += step) out[i] = find(i);
"""


@wp.func_native(
    f"{_HEAD}if (tall_units) {{{_SURFACES}}}\n"
    f"if (tall > 1) {{{_APART}}} else {{{_WHOLE}}}\n"
    "#undef WAIT\n#undef ANY\n#undef HANG\n#undef LEAST\n#undef MOST\n#undef COUNT\n"
)
def _linked_sets(
    tid: int,
    links: wp.array3d[wp.int32],
    y: wp.array2d[wp.int32],
    z: wp.array2d[wp.int32],
    kept: wp.array2d[wp.bool],
    v: wp.array2d[wp.int32],
    gaps: wp.array[wp.int32],
    tall_units: int,
    first_grid: int,
    scratch_out: wp.array3d[wp.int32],
    root_out: wp.array2d[wp.int32],
): ...


@wp.kernel
def linked_sets(
    links: wp.array3d[wp.int32],
    y: wp.array2d[wp.int32],
    z: wp.array2d[wp.int32],
    kept: wp.array2d[wp.bool],
    v: wp.array2d[wp.int32],
    gaps: wp.array[wp.int32],
    tall_units: int,
    first_grid: int,
    scratch_out: wp.array3d[wp.int32],
    root_out: wp.array2d[wp.int32],
):
    """A block a frame on CUDA, a thread a frame on the CPU.

    Args:
        links: ``(B, 3, N)``, the point each is linked with, N at most 8192; -1 = none. Two kinds
            sideways, then those behind nearer things.
        y: ``(B, N)``, down in the camera [depth units].
        z: Forward [depth units].
        kept: The points that take part.
        v: Rows of the image, for the grid's rows.
        gaps: The largest step in depth within a surface, by depth.
        tall_units: Surfaces at least so high stand on their own [depth units]; 0: none does.
        first_grid: The slot of the grid's first pixel.
        scratch_out: ``(B, 2, N)``, what the kernel needs meanwhile.
        root_out: ``(B, N)``, the smallest slot of each point's set.
    """
    _linked_sets(
        wp.tid(), links, y, z, kept, v, gaps, tall_units, first_grid, scratch_out, root_out
    )
