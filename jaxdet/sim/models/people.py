"""People, standing and walking.

Lengths are fractions of the stature after Drillis and Contini (1966), as in Winter, "Biomechanics
and Motor Control of Human Movement", 4th ed. 2009, Fig. 4.1: ankle 0.039, knee 0.285, hip
0.530, shoulder 0.818, chin 0.870; upper arm 0.186, forearm 0.146, hand 0.108; half shoulder
0.129, half hip 0.0955, foot 0.152. Statures are those of adults, 1.69 +- 0.09 m (both sexes of
ANSUR II, Gordon et al. 2014, pooled). Girths and clothes were chosen by eye.
"""

import numpy as np

from jaxdet.sim.appearance import BLACK, Texture, pick, tinted
from jaxdet.sim.mesh import Mesh, join, shift
from jaxdet.sim.shapes import ellipsoid, rings, tube

STRIDE_M = 1.4
"""Stride length (two steps) at 1.4 m/s and a stature of 1.7 m (Winter, Table 3.2) [m]."""

SKINS = ((224, 182, 150), (196, 146, 110), (148, 100, 72), (92, 62, 46))
HAIRS = ((30, 24, 20), (70, 48, 30), (120, 92, 60), (120, 118, 116))
SHIRTS = ((226, 226, 222), (28, 36, 66), (160, 30, 34), (40, 96, 66), (60, 60, 64), (220, 180, 60))
TROUSERS = ((34, 42, 70), (38, 38, 40), (92, 78, 58), (120, 120, 124))


def standing_person(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a standing person, slightly asymmetric."""
    del phase
    lean = rng.normal(0, 0.05, 4)
    hips = lean[0] * 0.6 + 0.04, -lean[0] * 0.6 - 0.04
    knees = abs(lean[1]) * 0.8, abs(lean[2]) * 0.5
    arms = 0.05 + lean[3], 0.02 - lean[3]
    elbows = tuple(rng.choice([0.15, 0.25, 1.5], 2, p=[0.5, 0.3, 0.2]).tolist())
    return _person(rng, hips, knees, arms, elbows)


def walking_person(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a person in mid-stride.

    Joint angles are sines similar to Winter's Fig. 2.18 (hip -20 to 30 degrees, knee 5 to 60): the
    swinging leg bends, and arms swing opposite to the legs.
    """
    hips, knees, arms = [], [], []
    for side in (0.0, np.pi):
        swing = phase + side
        hips.append(0.08 + 0.42 * np.sin(swing))
        knees.append(0.12 + 0.85 * max(0.0, np.cos(swing)) ** 1.5)
        arms.append(-0.40 * np.sin(swing))
    return _person(rng, tuple(hips), tuple(knees), tuple(arms), (0.45, 0.45))


def _person(
    rng: np.random.Generator,
    hips: tuple[float, ...],
    knees: tuple[float, ...],
    arms: tuple[float, ...],
    elbows: tuple[float, ...],
) -> Mesh:
    stature = float(np.clip(rng.normal(1.69, 0.09), 1.48, 1.92))
    girth = float(np.clip(rng.normal(1.0, 0.1), 0.82, 1.25))
    shirt, trousers, skin, hair, shoes = _clothes(rng)
    parts = [*_trunk(girth, shirt, trousers), *_head(rng, skin, hair)]
    for i, side in enumerate((1.0, -1.0)):
        parts += _leg(side, hips[i], knees[i], girth, trousers, shoes)
        parts += _arm(side, arms[i], elbows[i], girth, shirt, skin)
    if rng.random() < 0.25:
        pack = ellipsoid((-0.095 * girth, 0, 0.70), (0.065, 0.085, 0.125), _cloth(rng, SHIRTS))
        parts.append(pack)
    body = join(parts).scaled(stature)
    return body.moved(shift(z=-float(body.corners[..., 2].min())))


def _cloth(rng: np.random.Generator, colors: tuple[tuple[int, int, int], ...]) -> Texture:
    color = tinted(rng, colors[int(rng.integers(len(colors)))], 12)
    dark = (int(color[0] * 0.55), int(color[1] * 0.55), int(color[2] * 0.55))
    return Texture("cloth", color, dark, size_m=0.35, grain=4.0)


def _clothes(rng: np.random.Generator) -> tuple[Texture, Texture, Texture, Texture, Texture]:
    shirt = _cloth(rng, SHIRTS)
    if rng.random() < 0.3:
        bright = tinted(rng, (210, 210, 205), 15)
        kind = "stripes" if rng.random() < 0.5 else "checker"
        shirt = Texture(kind, shirt.color, bright, size_m=0.08, grain=4.0)
    skin = Texture("plain", tinted(rng, SKINS[int(rng.integers(4))], 6), grain=3.0)
    hair = Texture("plain", tinted(rng, HAIRS[int(rng.integers(4))], 6), grain=5.0)
    white = Texture("plain", (224, 222, 216), grain=4.0)
    return shirt, _cloth(rng, TROUSERS), skin, hair, pick(rng, BLACK, BLACK, white)


def _trunk(girth: float, shirt: Texture, trousers: Texture) -> list[Mesh]:
    """Build hips and chest from elliptic rings.

    A ring is given by its height, half width and half depth, as fractions of the stature.
    """
    hips = [
        (0.475, 0.070, 0.055),
        (0.50, 0.098, 0.070),
        (0.545, 0.100, 0.072),
        (0.60, 0.088, 0.064),
    ]
    chest = [
        (0.575, 0.094, 0.068), (0.62, 0.086, 0.064), (0.68, 0.094, 0.070), (0.74, 0.104, 0.072),
        (0.785, 0.112, 0.062), (0.812, 0.100, 0.050), (0.832, 0.058, 0.040), (0.845, 0.034, 0.034),
    ]  # fmt: skip
    return [
        _ellipses([(z, y * girth, x * girth) for z, y, x in hips], trousers),
        _ellipses([(z, y * girth**0.5, x * girth) for z, y, x in chest], shirt),
    ]


def _ellipses(rows: list[tuple[float, float, float]], texture: Texture) -> Mesh:
    angle = np.pi + np.arange(20) * (2 * np.pi / 20)  # the texture's seam is at the back
    points = [
        np.stack([x * np.cos(angle), y * np.sin(angle), np.full(20, z)], axis=1) for z, y, x in rows
    ]
    return rings(np.array(points), texture, smooth_along=True)


def _head(rng: np.random.Generator, skin: Texture, hair: Texture) -> list[Mesh]:
    long_hair = rng.random() < 0.35
    parts = [
        tube([(0, 0, 0.825), (0.006, 0, 0.88)], [0.034, 0.031], skin),
        ellipsoid((0.010, 0, 0.928), (0.056, 0.044, 0.068), skin),
        ellipsoid((-0.004, 0, 0.942), (0.058, 0.048, 0.060), hair),
        ellipsoid((0.066, 0, 0.922), (0.010, 0.009, 0.014), skin),
    ]
    if long_hair:
        parts.append(ellipsoid((-0.026, 0, 0.885), (0.036, 0.048, 0.075), hair))
    return parts


def _swung(length: float, angle: float) -> np.ndarray:
    """Return the vector along a limb from its joint, swung forward by ``angle``."""
    return np.array([length * np.sin(angle), 0.0, -length * np.cos(angle)])


def _leg(
    side: float, hip: float, knee: float, girth: float, trousers: Texture, shoes: Texture
) -> list[Mesh]:
    top = np.array([0.0, side * 0.052, 0.50])
    middle = top + _swung(0.530 - 0.285, hip) * (0.215 / 0.245)
    shin = hip - knee
    ankle = middle + _swung(0.285 - 0.039, shin)
    pitch = shin * 0.6
    toe = ankle + np.array([0.105 * np.cos(pitch), side * 0.012, 0.105 * np.sin(pitch) - 0.022])
    heel = ankle + np.array([-0.022, 0.0, -0.020])
    calf = middle + 0.35 * (ankle - middle)
    return [
        tube([top, middle], [0.050 * girth, 0.036 * girth**0.5], trousers),
        tube([middle, calf, ankle], [0.036 * girth**0.5, 0.034, 0.026], trousers),
        tube([heel, (heel + toe) / 2, toe], [0.019, 0.022, 0.015], shoes),
    ]


def _arm(
    side: float, swing: float, bend: float, girth: float, shirt: Texture, skin: Texture
) -> list[Mesh]:
    shoulder = np.array([0.0, side * 0.113, 0.795])
    out = np.array([0.0, side * 0.022, 0.0])
    elbow = shoulder + _swung(0.186, swing) + out
    wrist = elbow + _swung(0.146, swing + bend) + out * 0.2
    hand = wrist + _swung(0.045, swing + bend)
    return [
        tube([shoulder, elbow], [0.031 * girth**0.5, 0.025], shirt),
        tube([elbow, wrist], [0.025, 0.018], shirt),
        tube([wrist, hand, hand + _swung(0.03, swing + bend)], [0.014, 0.021, 0.012], skin),
    ]
