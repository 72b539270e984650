"""Push carts: a platform on castors with a handle and a load.

Sizes of EN 1757 platform trolleys: 0.8 to 1.2 by 0.5 to 0.7 m, handles 0.9 to 1.1 m high.
"""

import numpy as np

from jaxdet.sim.appearance import BLACK, BLUE_BIN, CARTON, RUBBER, STEEL, WHITE_BOX, WOOD, pick
from jaxdet.sim.mesh import Mesh, join
from jaxdet.sim.shapes import box, tube

DECK_M = 0.18
"""Height of the platform above the floor [m]."""


def cart(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a cart with a box; its handle is at -x."""
    del phase
    length, width, handle = rng.uniform((0.8, 0.5, 0.9), (1.2, 0.7, 1.1)).tolist()
    deck, frame = pick(rng, WOOD, STEEL), pick(rng, STEEL, BLACK)
    parts = [box((length, width, 0.06), deck, (0.0, 0.0, DECK_M - 0.06))]
    for x in (-1, 1):
        for y in (-1, 1):
            place = (x * (length / 2 - 0.1), y * (width / 2 - 0.07), 0.0)
            parts.append(box((0.12, 0.04, DECK_M - 0.06), RUBBER, place))
    a, b, back = width / 2 - 0.03, handle, -length / 2 + 0.03
    bow = [(back, -a, DECK_M), (back, -a, b), (back, a, b), (back, a, DECK_M)]
    parts.append(tube(bow, [0.017] * 4, frame, 10))
    load = rng.uniform((0.5, 0.6, 0.25), (0.85, 0.95, 0.6)).tolist()
    size = (load[0] * length, load[1] * width, load[2])
    parts.append(box(size, pick(rng, CARTON, WHITE_BOX, BLUE_BIN), (0.04, 0.0, DECK_M)))
    return join(parts)
