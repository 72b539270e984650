"""Office chairs, desks, beds, racks, plants and bags.

Office chairs: EN 1335-1, seats 0.42-0.52 m high, feet of 0.30-0.35 m. Beds: EN 1725, mattresses of
0.9-1.6 by 1.9-2.0 m. Other sizes are those of a furniture catalogue.
"""

import numpy as np

from jaxdet.sim.appearance import BLACK, CARTON, STEEL, WHITE_BOX, WOOD, Texture, pick, tinted
from jaxdet.sim.mesh import Mesh, join, shift
from jaxdet.sim.models.furniture import SEATS, table
from jaxdet.sim.shapes import box, cylinder, ellipsoid, lathe, rings, tube

LEAVES = Texture("grass", color=(40, 74, 34), accent=(90, 126, 60), size_m=0.08, grain=8.0)


def office_chair(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a swivel chair on five feet; its back is at -x."""
    del phase
    width, seat, back, foot = rng.uniform((0.42, 0.42, 0.85, 0.27), (0.5, 0.52, 1.1, 0.33)).tolist()
    color = tinted(rng, SEATS[int(rng.integers(4))], 8)
    cover = Texture("cloth", color, (color[0] // 2, color[1] // 2, color[2] // 2), 0.3, 4.0)
    parts = [box((width, width, 0.08), cover, (0, 0, seat - 0.08))]
    parts.append(tube([(0, 0, 0.08), (0, 0, seat - 0.06)], [0.03, 0.03], BLACK, 12))
    for angle in float(rng.uniform(0, 1.2)) + np.arange(5) * 2 * np.pi / 5:
        x, y = foot * float(np.cos(angle)), foot * float(np.sin(angle))
        parts.append(tube([(0, 0, 0.1), (x, y, 0.06)], [0.025, 0.018], BLACK, 8))
        parts.append(ellipsoid((x, y, 0.03), (0.03, 0.03, 0.03), BLACK, 8))
    parts.append(box((0.05, width - 0.04, back - seat - 0.12), cover, (-width / 2, 0, seat + 0.12)))
    parts.append(box((0.03, 0.08, 0.25), BLACK, (-width / 2, 0, seat - 0.05)))
    if rng.random() < 0.6:
        for side in (-1, 1):
            rest = side * (width / 2 + 0.02)
            parts.append(box((0.25, 0.05, 0.03), BLACK, (0, rest, seat + 0.2)))
            parts.append(box((0.04, 0.03, 0.2), BLACK, (0, rest, seat)))
    return join(parts)


def desk(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a table with a screen, boxes, books and cups on it."""
    parts = [table(rng, phase)]
    top = float(parts[0].corners[..., 2].max())
    if rng.random() < 0.7:
        wide, tall = rng.uniform((0.4, 0.25), (0.6, 0.38)).tolist()
        parts.append(box((0.03, wide, tall), BLACK, (0.15, 0, top + 0.12)))
        parts.append(box((0.15, 0.2, 0.02), BLACK, (0.15, 0, top)))
        parts.append(box((0.03, 0.04, 0.15), BLACK, (0.17, 0, top)))
    for side in rng.permutation([-0.45, -0.3, 0.3, 0.42])[: int(rng.integers(1, 4))].tolist():
        at = float(rng.uniform(-0.2, 0.2)), side, top
        if rng.random() < 0.6:
            size = rng.uniform((0.1, 0.1, 0.02), (0.25, 0.14, 0.3)).tolist()
            parts.append(box((size[0], size[1], size[2]), pick(rng, CARTON, WHITE_BOX, BLACK), at))
        else:
            cup = cylinder(float(rng.uniform(0.03, 0.05)), float(rng.uniform(0.08, 0.2)), STEEL)
            parts.append(cup.moved(shift(*at)))
    return join(parts)


def bed(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a bed with a pillow and a blanket; its head is at -x."""
    del phase
    width, height = float(rng.uniform(0.9, 1.6)), float(rng.uniform(0.4, 0.6))
    sheet, blanket = (
        Texture("cloth", tinted(rng, c, 15)) for c in ((200, 198, 190), (90, 90, 120))
    )
    foot, frame = float(rng.choice([0.0, 0.12])), pick(rng, WOOD, STEEL, BLACK)
    parts = [
        box((2.0, width, 0.2 if foot else height - 0.2), frame, (0, 0, foot)),
        box((1.95, width - 0.04, 0.2), sheet, (0, 0, height - 0.2)),
        box((0.05, width, float(rng.uniform(0.7, 1.1))), frame, (-1.02, 0, 0)),
        ellipsoid((-0.75, 0, height + 0.04), (0.2, 0.32, 0.08), sheet),
        box((1.2, width + 0.06, 0.06), blanket, (0.38, 0, height)),
    ]
    for x in (-0.95, 0.95):
        for y in (-1, 1):
            parts.append(box((0.06, 0.06, max(foot, 0.02)), frame, (x, y * (width / 2 - 0.05), 0)))
    return join(parts)


def rack(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build an open rack of boards with boxes on them; it is seen from +x."""
    del phase
    deep, wide, tall = rng.uniform((0.28, 0.6, 0.8), (0.45, 1.1, 1.9)).tolist()
    frame, levels = pick(rng, WOOD, STEEL, BLACK), int(rng.integers(3, 6))
    parts = [
        box((0.04, 0.04, tall), frame, (x * (deep / 2 - 0.02), y * (wide / 2 - 0.02), 0))
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    for level in np.linspace(0.08, tall - 0.03, levels).tolist():
        parts.append(box((deep, wide, 0.025), frame, (0, 0, level)))
        room = min((tall - 0.11) / (levels - 1), 0.4) - 0.06
        for side in np.arange(-wide / 2 + 0.15, wide / 2 - 0.1, 0.26).tolist():
            if rng.random() < 0.55 and level < tall - 0.1:
                size = rng.uniform((0.15, 0.12, 0.4 * room), (0.26, 0.22, room)).tolist()
                goods = Texture("plain", tinted(rng, (130, 110, 100), 50))
                at = (float(rng.uniform(-0.05, 0.05)), side, level + 0.025)
                parts.append(box((size[0], size[1], size[2]), pick(rng, CARTON, goods), at))
    return join(parts)


def plant(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a plant in a pot, with leaves in several clusters."""
    del phase
    pot, high, tall = rng.uniform((0.09, 0.15, 0.3), (0.18, 0.35, 1.2)).tolist()
    clay = Texture("plain", tinted(rng, (150, 90, 60), 30), grain=3.0)
    earth = lathe([(pot, high), (0.01, high)], BLACK)
    parts = [lathe([(0.7 * pot, 0.0), (pot, high)], clay), earth]
    for _ in range(int(rng.integers(4, 10))):
        angle, out = float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0.05, 0.12 + 0.25 * tall))
        x, y = out * float(np.cos(angle)), out * float(np.sin(angle))
        z = high + float(rng.uniform(0.2, 1.0)) * tall
        parts.append(tube([(0, 0, high), (x, y, z)], [0.008, 0.005], LEAVES, 6))
        size = rng.uniform((0.05, 0.05, 0.02), (0.16, 0.16, 0.14)).tolist()
        parts.append(ellipsoid((x, y, z), (size[0], size[1], size[2]), LEAVES, 10))
    return join(parts)


def bag(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a backpack or a holdall that stands or lies on the floor."""
    del phase
    deep, wide, tall = rng.uniform((0.14, 0.28, 0.2), (0.28, 0.5, 0.5)).tolist()
    color = tinted(rng, SEATS[int(rng.integers(4))], 15)
    cloth = Texture("cloth", color, (color[0] // 2, color[1] // 2, color[2] // 2), 0.3, 4.0)
    # An ellipsoid with its lowest part cut off by the floor.
    lift, angle = np.linspace(-0.958, 1.52, 9), np.arange(16) * (2 * np.pi / 16)
    across = np.cos(lift)[:, None] * np.stack([np.cos(angle), np.sin(angle)])[:, None]
    level = np.broadcast_to(0.45 + 0.55 * np.sin(lift)[:, None], across[0].shape)
    body = rings(np.stack([*across, level], axis=-1) * (0.62 * deep, 0.56 * wide, tall), cloth)
    pocket = box((0.3 * deep, 0.6 * wide, 0.45 * tall), cloth, (0.5 * deep, 0, 0.0))
    strap = [(0, -0.1, 0.9 * tall), (0, 0, 1.15 * tall), (0, 0.1, 0.9 * tall)]
    return join([body, pocket, tube(strap, [0.012] * 3, cloth, 8)])
