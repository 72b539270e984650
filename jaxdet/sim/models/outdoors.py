"""Tree trunks and street lights.

Trunks: diameters at breast height of urban trees, 0.15-0.45 m, a taper of about 1 cm per metre, as
usual in forestry, and a root flare (our choice). Street lights: EN 40-2 poles of 5-6 m, 0.11-0.17 m
at the base above a wider door section, 0.06-0.08 m at the top.
"""

import numpy as np

from jaxdet.sim.appearance import STEEL, Texture, tinted
from jaxdet.sim.mesh import Mesh, join
from jaxdet.sim.shapes import box, circle, fan, lathe, rings, tube

BARKS = ((96, 78, 60), (120, 110, 98), (74, 62, 54))


def tree_trunk(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a slightly irregular trunk of 3-4 m with three branches above 2.3 m."""
    del phase
    radius, height = float(rng.uniform(0.075, 0.225)), float(rng.uniform(3.0, 4.0))
    z = np.r_[0.0, 0.04, 0.1, 0.2, np.linspace(0.4, height, 14)]
    angle = np.arange(36) * (2 * np.pi / 36)
    flare = 1 + 0.55 * np.exp(-z / 0.12) - 0.005 * z / radius
    bulge = np.zeros((len(z), 36))
    for k in (2, 3, 5, 8):
        turn = rng.uniform(0, 2 * np.pi) + rng.normal(0, 0.15) * z
        bulge += rng.normal(0, 0.035 / np.sqrt(k)) * np.cos(k * angle - turn[:, None])
    root = 0.18 * np.exp(-z / 0.1)[:, None] * np.cos(5 * angle + rng.uniform(0, 6))
    size = radius * (flare[:, None] * (1 + bulge) + root)
    lean, sway = rng.normal(0, 0.02, 2), rng.uniform(0, 6, 2)
    x = lean[0] * z + 0.015 * np.sin(2 * z + sway[0])
    y = lean[1] * z + 0.015 * np.sin(2 * z + sway[1])
    color = tinted(rng, BARKS[int(rng.integers(3))], 8)
    dark = (int(color[0] * 0.4), int(color[1] * 0.4), int(color[2] * 0.4))
    bark = Texture("bark", color, dark, size_m=0.18, grain=8.0)
    points = np.stack(
        [x[:, None] + size * np.cos(angle), y[:, None] + size * np.sin(angle),
         np.repeat(z[:, None], 36, axis=1)], axis=-1,
    )  # fmt: skip
    parts = [rings(points, bark, smooth_along=True), fan(points[-1], bark)]
    for _ in range(3):
        way, start = rng.uniform(0, 2 * np.pi), rng.uniform(2.4, height - 0.2)
        out = np.array([np.cos(way), np.sin(way), 0.9])
        base = np.array([0, 0, start])
        parts.append(
            tube([base, base + 0.5 * out, base + 1.1 * out], [0.05, 0.035, 0.02], bark, 10)
        )
    return join(parts)


def street_light(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a pole with a door section, an arm and a lamp."""
    del phase
    height, base = float(rng.uniform(5.0, 6.0)), float(rng.uniform(0.055, 0.085))
    paint = Texture("plain", tinted(rng, (96, 104, 104), 20), grain=3.0, gloss=0.1)
    foot = box((4.4 * base, 4.4 * base, 0.02), STEEL)
    profile = [(1.25 * base, 0.02), (1.25 * base, 1.0), (base, 1.06), (0.5 * base, height)]
    top = np.array([0.0, 0.0, height - 0.05])
    arm = tube([top, top + (0.5, 0, 0.15), top + (1.1, 0, 0.18)], [0.03, 0.03, 0.03], paint, 10)
    lamp = box((0.5, 0.18, 0.08), paint, tuple((top + (1.2, 0, 0.14)).tolist()))
    door = box((0.02, 1.3 * base, 0.4), STEEL, (1.18 * base, 0, 0.45))
    lid = fan(circle(0.5 * base, height, 40), paint)
    return join([foot, lathe(profile, paint, 40), arm, lamp, door, lid])
