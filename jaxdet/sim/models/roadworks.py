"""Roadblocks: water-filled barriers and traffic cones.

Cones: heights of EN 13422 are 0.30, 0.50, 0.75 and 1.00 m, orange with white bands; the base is
about half as wide as the cone is high (data sheets: 0.75 m on 0.40 m). Barriers: 1.2-2.0 m by
0.40-0.60 m, 0.75-1.0 m high, alternating red and white, on a wide foot with two slots for a fork
(data sheets of water-filled plastic barriers).
"""

from itertools import pairwise

import numpy as np

from jaxdet.sim.appearance import BLACK, REFLECTIVE, RUBBER, SIGNAL_ORANGE, SIGNAL_RED, Texture
from jaxdet.sim.mesh import Mesh, join, shift
from jaxdet.sim.shapes import box, circle, fan, lathe, prism

CONE_HEIGHTS_M = (0.50, 0.75, 1.00)
WHITE_PLASTIC = Texture("plain", (226, 226, 222), grain=4.0)


def cone(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a traffic cone with one or two white bands."""
    del phase
    height = CONE_HEIGHTS_M[int(rng.choice(3, p=[0.35, 0.5, 0.15]))]
    width = {0.50: 0.29, 0.75: 0.39, 1.00: 0.45}[height]
    low, high, foot = 0.36 * width, 0.03, 0.035
    steps = [0.0, 0.28, 0.48, 0.60, 0.80, 1.0] if rng.random() < 0.7 else [0.0, 0.45, 0.75, 1.0]
    body = SIGNAL_RED if rng.random() < 0.3 else SIGNAL_ORANGE
    parts = [box((width, width, foot), RUBBER if rng.random() < 0.6 else body, top=0.94)]
    for i, (a, b) in enumerate(pairwise(steps)):
        profile = [(low + (high - low) * share, foot + (height - foot) * share) for share in (a, b)]
        parts.append(lathe(profile, REFLECTIVE if i % 2 else body, 36))
    parts.append(fan(circle(high, height, 36), body))
    return join(parts).moved(shift(yaw=float(rng.uniform(0, np.pi))))


def barrier(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a water-filled barrier, its length along y."""
    del phase
    length, depth, height = rng.uniform((1.2, 0.40, 0.70), (1.6, 0.50, 0.90)).tolist()
    color = SIGNAL_RED if rng.random() < 0.6 else WHITE_PLASTIC
    side = np.array(
        [[-1.0, 0.0], [1.0, 0.0], [1.0, 0.16], [0.52, 0.40], [0.46, 0.80], [0.40, 1.0],
         [-0.40, 1.0], [-0.46, 0.80], [-0.52, 0.40], [-1.0, 0.16]]
    )  # fmt: skip
    outline = side * (depth / 2, height)
    parts = [prism(outline, length, color, bevel=0.02)]
    for y in (-0.27, 0.27):
        slot = box((depth + 0.006, 0.16, 0.075), BLACK, (0, y * length, 0.0))
        parts.append(slot)
    band = WHITE_PLASTIC if color is SIGNAL_RED else SIGNAL_RED
    width = 2 * (0.46 * depth / 2) + 0.008
    parts.append(box((width, length * 0.72, height * 0.12), band, (0, 0, height * 0.62)))
    for y in (-0.3, 0.3):
        parts.append(
            lathe([(0.05, height - 0.005), (0.05, height + 0.03)], BLACK, 20).moved(
                shift(y=y * length)
            )
        )
        parts.append(fan(circle(0.05, height + 0.03, 20, y=y * length), BLACK))
    return join(parts)
