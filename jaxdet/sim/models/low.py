"""Low objects of 2 to 10 cm.

Bricks: 240 x 115 x 71 mm (DIN 105 NF). Planks: 18-50 mm. Cables: 20-32 mm rubber hose. Books: A4,
20-50 mm. Kerbs: 80-100 mm above the road (EN 1340). Bottles: 0.5-1.5 l, 65-90 mm across.
"""

import numpy as np

from jaxdet.sim.appearance import CONCRETE, WOOD, Texture, tinted
from jaxdet.sim.mesh import Mesh, join
from jaxdet.sim.shapes import box, tube

LOW_THINGS = ("brick", "plank", "cable", "book", "kerb", "bottle")


def low_thing(kind: str, rng: np.random.Generator) -> Mesh:
    """Build one of ``LOW_THINGS``, its longest side along y."""
    if kind == "brick":
        clay = Texture("noise", tinted(rng, (164, 84, 62), 8), (120, 60, 46), 0.2, 5.0)
        return box((0.115, 0.24, 0.071), clay)
    if kind == "plank":
        thick, width, length = rng.uniform((0.018, 0.10, 0.6), (0.05, 0.20, 1.4)).tolist()
        return box((width, length, thick), WOOD)
    if kind == "book":
        color = tinted(rng, (130, 50, 60), 40)
        cover = Texture("carton", color, (230, 220, 190), 0.3, 3.0)
        return box((0.21, 0.297, float(rng.uniform(0.02, 0.05))), cover)
    if kind == "kerb":
        height, length = rng.uniform((0.08, 0.8), (0.10, 1.2)).tolist()
        return box((0.15, length, height), CONCRETE, top=0.97)
    if kind == "bottle":
        radius = float(rng.uniform(0.0325, 0.045))
        green = Texture("plain", tinted(rng, (40, 90, 50), 20), grain=3.0, gloss=0.5)
        path = [(0, -0.13, radius), (0, 0.05, radius), (0, 0.10, radius), (0, 0.15, radius)]
        return tube(path, [radius, radius, 0.5 * radius, 0.4 * radius], green, 20, rounded=False)
    radius = float(rng.uniform(0.010, 0.016))
    y = np.linspace(-0.7, 0.7, 25)
    bend = sum(rng.normal(0, 0.05) * np.sin(k * y * 2 + rng.uniform(0, 6)) for k in (1, 2, 3))
    path = np.stack([np.broadcast_to(bend, y.shape), y, np.full_like(y, radius)], axis=1)
    rubber = Texture("plain", tinted(rng, (190, 90, 30), 20), grain=3.0)
    return join([tube(path, [radius] * 25, rubber, 12)])
