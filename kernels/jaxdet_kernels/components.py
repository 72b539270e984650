"""Connected components of small graphs, a frame each: union-find with the smaller root.

A root is always the smallest node of its component, so the result does not depend on the order in
which links are taken. On CUDA a block does a frame with its forest in shared memory and joins
roots by compare-and-swap, which only ever hangs a root below a smaller node; on the CPU a thread
does a frame.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

COMPONENTS_BLOCK = 512
"""Threads of a block on CUDA."""

_COMPONENTS = """
    const int N = links.shape[2], kinds = links.shape[1];
#if defined(__CUDA_ARCH__)
    const int b = tid / 512, thread = tid % 512;
    __shared__ int parent[8192];
    const int step = 512;
    #define WAIT() __syncthreads()
    #define HANG(high, low) atomicCAS(&parent[high], high, low)
#else
    const int b = tid, thread = 0;
    int parent[8192];
    const int step = 1;
    #define WAIT()
    #define HANG(high, low) (parent[high] = low, high)
#endif
    const int* other = links.data + (size_t)b * kinds * N;
    int* out = root_out.data + (size_t)b * N;
    for (int i = thread; i < N; i += step) parent[i] = i;
    WAIT();
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
    for (int k = 0; k < kinds; ++k)
        for (int i = thread; i < N; i += step) {
            int one = i, two = other[k * N + i];
            while (two >= 0) {
                one = find(one);
                two = find(two);
                if (one == two) break;
                const int high = one > two ? one : two, low = one > two ? two : one;
                if (HANG(high, low) == high) break;
            }
        }
    WAIT();
    for (int i = thread; i < N; i += step) out[i] = find(i);
    #undef WAIT
    #undef HANG
"""


@wp.func_native(_COMPONENTS)
def _components(tid: int, links: wp.array3d[wp.int32], root_out: wp.array2d[wp.int32]): ...


@wp.kernel
def components(links: wp.array3d[wp.int32], root_out: wp.array2d[wp.int32]):
    """A block a frame on CUDA, a thread a frame on the CPU.

    Args:
        links: ``(B, K, N)``, for each node up to K nodes it is linked with; -1 = none.
        root_out: ``(B, N)``, the smallest node of each node's component.
    """
    _components(wp.tid(), links, root_out)
