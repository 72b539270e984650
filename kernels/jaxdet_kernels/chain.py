"""Calls other kernels on the CPU, frame by frame."""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, includes, native_kernel

wp.set_module_options(
    {
        "enable_backward": False,
        "cpu_compiler_flags": CPU_FLAGS,
        "extra_build_options": includes("frame_loop.h"),
    }
)


@native_kernel(
    body="""
#if !defined(__CUDA_ARCH__)
    typedef unsigned long long Address;
    FrameLoop{(const Address*)kernels.data, kernels.shape[0], (Address*)words.data,
              (const Address*)rooms.data, rooms.shape[0], next.data, frames}.run();
#endif
""",
)
def frame_loop(
    kernels: wp.array2d[wp.uint64],  # (K, 4) see frame_loop.h
    words: wp.array[wp.uint64],  # the arguments of all of them
    rooms: wp.array2d[wp.uint64],  # (M, 3) memory with room for one frame, likewise
    next: wp.array[wp.int32],  # (1,) the first frame that no thread has taken
    frames: int,  # B
):
    """Takes frames until there are no more; for the CPU."""
