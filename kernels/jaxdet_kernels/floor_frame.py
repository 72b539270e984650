"""Cells on the floor: right, forward and height. Twin of ``jaxdet/floor_frame.py``."""

import warp as wp

from jaxdet_kernels.native_source import native

wp.set_module_options({"enable_backward": False})


@wp.func_native(
    native(
        "floor_frame.h",
        body="""
    const Team team(tid, share);
    const int batch = z.shape[0], cells = z.shape[1] * z.shape[2];
    for (int b = team.index; b < batch; b += shares) {
        const FloorFrame frame(floor.data + b * FloorFrame::VALUES);
        for (int k = team.rank; k < cells; k += team.size) {
            const size_t i = (size_t)b * cells + k;
            const int px = x.data[i], py = y.data[i], pz = z.data[i];
            right_out.data[i] = frame.right(px, py, pz);
            forward_out.data[i] = frame.forward(px, py, pz);
            height_out.data[i] = frame.above(px, py, pz, forward_out.data[i]);
        }
    }
""",
    )
)
def _floor_frame(
    tid: int,
    share: int,
    shares: int,
    x: wp.array3d[wp.int32],
    y: wp.array3d[wp.int32],
    z: wp.array3d[wp.int32],
    floor: wp.array2d[wp.int32],
    right_out: wp.array3d[wp.int32],
    forward_out: wp.array3d[wp.int32],
    height_out: wp.array3d[wp.int32],
): ...


@wp.kernel
def floor_frame(
    share: int,
    shares: int,
    x: wp.array3d[wp.int32],
    y: wp.array3d[wp.int32],
    z: wp.array3d[wp.int32],
    floor: wp.array2d[wp.int32],
    right_out: wp.array3d[wp.int32],
    forward_out: wp.array3d[wp.int32],
    height_out: wp.array3d[wp.int32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        x: ``(B, R, C)``, colour optical frame [depth units].
        y: Likewise.
        z: Likewise, 0 = no measurement.
        floor: ``(B, 13)``, see :class:`jaxdet.floor_frame.FloorFrame`.
        right_out: ``(B, R, C)``, on the floor [depth units].
        forward_out: Likewise.
        height_out: Above the floor, ramps included.
        scratch_out: Not used.
    """
    _floor_frame(wp.tid(), share, shares, x, y, z, floor, right_out, forward_out, height_out)
