"""A method that needs no features: components of the range image."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from benchmarks.baselines.frames import Frame
from jaxdet.camera import pixel_rays


def range_image(frame: Frame, angle_deg: float, stride: int = 1) -> np.ndarray:
    """Label connected pixels whose surface is not seen edge-on.

    After Bogoslavskyi and Stachniss, Fast Range Image-Based Segmentation of Sparse 3D Laser
    Scans for Online Operation, IROS 2016 (the method of depth_clustering): with ``d1 >= d2`` the
    ranges of two neighbours, along rows or columns, and ``alpha`` the angle between their rays,

        beta = atan2(d2 sin alpha, d1 - d2 cos alpha)

    is the angle between the farther point's ray and the line through both points; they belong to
    one object if ``beta > angle``. Own implementation for depth images: only pixels above the
    floor, rays of the colour camera.

    Args:
        frame: The frame.
        angle_deg: The paper's theta [degree].
        stride: Step between the rows and columns that are used; a larger one makes beta less noisy.

    Returns:
        Labels ``(H, W)`` int32, -1 = none.
    """
    keep = frame.keep[::stride, ::stride]
    rays = np.stack([*pixel_rays(frame.calibration.image), np.ones(frame.z.shape)], axis=-1)
    rays = rays[::stride, ::stride]
    length = np.linalg.norm(rays, axis=-1)
    distance = frame.z[::stride, ::stride] * frame.calibration.depth_unit * length
    rays = rays / length[..., None]
    index = np.arange(keep.size).reshape(keep.shape)
    links: list[np.ndarray] = []
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        cos = np.clip(np.sum(rays[one] * rays[other], axis=-1), -1, 1)
        far = np.maximum(distance[one], distance[other])
        near = np.minimum(distance[one], distance[other])
        beta = np.arctan2(near * np.sqrt(1 - cos * cos), far - near * cos)
        joined = keep[one] & keep[other] & (beta > np.deg2rad(angle_deg))
        links.append(np.stack([index[one][joined], index[other][joined]]))
    first, second = np.concatenate(links, axis=1)
    graph = coo_matrix((np.ones(len(first), bool), (first, second)), (keep.size, keep.size))
    labels = connected_components(graph.tocsr(), directed=False)[1].reshape(keep.shape)
    height, width = frame.z.shape
    wide = np.repeat(np.repeat(labels, stride, axis=0), stride, axis=1)[:height, :width]
    return np.where(frame.keep, wide, -1).astype(np.int32)
