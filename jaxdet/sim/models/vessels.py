"""Buckets, bins, cable drums.

Buckets: household and builder's buckets of 10-20 l, rim diameter 0.26-0.36 m, height 0.25-0.34 m.
Bins: pedal and office bins 0.3-0.7 m high; wheeled bins of EN 840-1, 120 l: 0.48 x 0.55 x 0.93 m.
Cable drums: 0.1-0.2 m, plastic or plywood.
"""

import numpy as np

from jaxdet.sim.appearance import BLACK, STEEL, WOOD, Texture, tinted
from jaxdet.sim.mesh import Mesh, join, sheet
from jaxdet.sim.shapes import box, circle, cylinder, fan, lathe, tube

PLASTICS = (
    (24, 60, 130),
    (170, 30, 30),
    (36, 110, 60),
    (40, 40, 42),
    (214, 180, 40),
    (200, 204, 206),
)


def bucket(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build an open bucket with a rim and a handle that is down or up."""
    del phase
    rim, height = float(rng.uniform(0.13, 0.18)), float(rng.uniform(0.25, 0.34))
    low = rim * float(rng.uniform(0.68, 0.8))
    color = tinted(rng, PLASTICS[int(rng.integers(6))], 10)
    skin = Texture("plain", color, grain=3.0, gloss=0.1)
    inside = Texture("plain", (int(color[0] * 0.8), int(color[1] * 0.8), int(color[2] * 0.8)))
    wall, lip = 0.004, 0.008
    outer = [(low, 0.0), (rim, height - 0.02), (rim + lip, height - 0.018), (rim + lip, height)]
    inner = [(rim - wall, height), (low - wall, 0.01)]
    ring = [(rim + lip, height), (rim - wall, height)]
    parts = [lathe(outer, skin), lathe(ring, skin), lathe(inner, inside)]
    parts.append(fan(circle(low - wall, 0.01), inside))
    lift = float(rng.choice([0.15, 1.2]))
    sweep = np.linspace(0, np.pi, 13)
    reach = rim + lip + 0.004
    path = np.stack(
        [reach * np.sin(sweep) * np.cos(lift), reach * np.cos(sweep),
         height - 0.03 + reach * np.sin(sweep) * np.sin(lift) * 0.9], axis=1,
    )  # fmt: skip
    return join([*parts, tube(path, [0.004] * 13, STEEL, 8)])


def bin_with_lid(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a round office bin, or a wheeled bin with a lid."""
    del phase
    color = tinted(rng, PLASTICS[int(rng.integers(6))], 10)
    skin = Texture("plain", color, grain=3.0)
    if rng.random() < 0.5:
        radius, height = float(rng.uniform(0.13, 0.2)), float(rng.uniform(0.35, 0.7))
        band = cylinder(radius + 0.004, 0.03, BLACK)
        lid = lathe([(radius, height), (0.6 * radius, height + 0.05), (0.01, height + 0.07)], BLACK)
        return join([cylinder(radius, height, skin), band, lid])
    body = _taper(0.38, 0.42, 0.50, 0.48, 0.86, skin)
    lid = box((0.54, 0.50, 0.06), skin, (0, 0, 0.87), top=0.9)
    grip = tube([(-0.29, -0.2, 0.86), (-0.29, 0.2, 0.86)], [0.015, 0.015], BLACK)
    wheels = [
        tube([(-0.20, s * 0.18, 0.1), (-0.20, s * 0.24, 0.1)], [0.1, 0.1], BLACK, 24, rounded=False)
        for s in (1, -1)
    ]
    return join([body, lid, grip, *wheels])


def _taper(
    low_x: float, low_y: float, high_x: float, high_y: float, height: float, texture: Texture
) -> Mesh:
    """Build a box on z = 0.02 m that widens upwards."""
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    low = np.column_stack([signs * (low_x, low_y), np.full(4, 0.02)])
    high = np.column_stack([signs * (high_x, high_y), np.full(4, height)])
    order = [0, 1, 2, 3, 0]
    return sheet(np.array([low[order], high[order]]), texture)


def cable_drum(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a cable drum that lies on one of its discs."""
    del phase
    radius, height = rng.uniform((0.08, 0.06), (0.16, 0.20)).tolist()
    disc = WOOD if rng.random() < 0.5 else Texture("plain", tinted(rng, (40, 40, 42), 20))
    cable = Texture("stripes", tinted(rng, (170, 60, 40), 40), (60, 24, 20), 0.012, 2.0)
    thick, core = 0.008, radius * float(rng.uniform(0.6, 0.9))
    parts = [lathe([(core, thick), (core, height - thick)], cable)]
    for low in (0.0, height - thick):
        parts.append(lathe([(radius, low), (radius, low + thick)], disc))
        parts += [fan(circle(radius, z), disc) for z in (low, low + thick)]
    return join(parts)
