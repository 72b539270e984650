"""Tables, chairs, sofas.

Tables: EN 527-1 and EN 15372, tops 0.72-0.76 m high, 1.0-1.6 by 0.6-0.8 m. Chairs: EN 1335 and
EN 16139, seats 0.43-0.47 m high and 0.40-0.46 m wide, backs up to 0.80-0.90 m. Sofas and round
tables: sizes of a furniture catalogue.
"""

import numpy as np

from jaxdet.sim.appearance import BLACK, CHROME, STEEL, WOOD, Texture, pick, tinted
from jaxdet.sim.mesh import Mesh, join
from jaxdet.sim.shapes import box, circle, fan, lathe, tube

SEATS = ((40, 42, 46), (30, 60, 110), (150, 40, 40), (190, 160, 120))


def table(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a table on four legs."""
    del phase
    length, width, height = rng.uniform((1.0, 0.60, 0.72), (1.6, 0.80, 0.76)).tolist()
    white = Texture("plain", (214, 212, 206), grain=3.0)
    top, legs = pick(rng, WOOD, white), pick(rng, BLACK, STEEL, WOOD)
    thick, leg = 0.028, float(rng.uniform(0.035, 0.06))
    parts = [box((width, length, thick), top, (0, 0, height - thick))]
    for x in (-1, 1):
        for y in (-1, 1):
            place = (x * (width / 2 - 0.05), y * (length / 2 - 0.06), 0.0)
            parts.append(box((leg, leg, height - thick), legs, place))
        rail = (x * (width / 2 - 0.05), 0.0, height - thick - 0.06)
        parts.append(box((0.02, length - 0.12, 0.06), legs, rail))
    return join(parts)


def chair(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a chair on four legs; its back is at -x."""
    del phase
    width, seat, back = rng.uniform((0.40, 0.43, 0.80), (0.46, 0.47, 0.90)).tolist()
    color = tinted(rng, SEATS[int(rng.integers(4))], 8)
    cover = Texture("cloth", color, (color[0] // 2, color[1] // 2, color[2] // 2), 0.3, 4.0)
    frame = pick(rng, CHROME, BLACK, WOOD)
    radius, a = float(rng.uniform(0.011, 0.018)), width / 2
    parts = [box((width, width, 0.045), cover, (0, 0, seat - 0.045))]
    for y in (-1, 1):
        side = y * (a - 0.02)
        front = [(a - 0.03, side, seat - 0.04), (a, side, radius)]
        rear = [(-a - 0.02, side, radius), (-a + 0.02, side, seat), (-a - 0.05, side, back)]
        parts.append(tube(front, [radius] * 2, frame, 10))
        parts.append(tube(rear, [radius] * 3, frame, 10))
    lean = np.array([-a - 0.035, 0.0, back - 0.30])
    parts.append(box((0.03, width - 0.03, 0.28), cover, tuple(lean.tolist())))
    return join(parts)


def round_table(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a round table on a column with a flat foot."""
    del phase
    radius, height = rng.uniform((0.30, 0.70), (0.45, 0.76)).tolist()
    top, column = pick(rng, WOOD, Texture("plain", (214, 212, 206))), pick(rng, BLACK, STEEL)
    plate = [(radius, height - 0.028), (radius, height)]
    post = [(0.26, 0.0), (0.26, 0.012), (0.04, 0.03), (0.04, height - 0.028)]
    lids = [fan(circle(radius, z), top) for z in (height - 0.028, height)]
    return join([lathe(plate, top), *lids, lathe(post, column)])


def sofa(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a sofa or armchair; its back is at -x."""
    del phase
    length, depth, seat, back = rng.uniform((0.8, 0.75, 0.38, 0.70), (2.0, 0.90, 0.45, 0.90))
    r, g, b = tinted(rng, SEATS[int(rng.integers(4))], 12)
    cover = Texture("cloth", (r, g, b), (r // 2, g // 2, b // 2), 0.4, 4.0)
    arm, foot = 0.14, float(rng.choice([0.0, 0.05, 0.12]))
    parts = [
        box((depth, length, seat - foot), cover, (0, 0, foot)),
        box((0.2, length, back - seat), cover, (-depth / 2 + 0.1, 0, seat)),
    ]
    for y in (-1, 1):
        place = (0.0, y * (length / 2 + arm / 2), foot)
        parts.append(box((depth, arm, seat + 0.18 - foot), cover, place))
        for x in (-1, 1):
            corner = (x * (depth / 2 - 0.06), y * (length / 2 - 0.06), 0.0)
            parts.append(box((0.05, 0.05, max(foot, 0.01)), BLACK, corner))
    return join(parts)
