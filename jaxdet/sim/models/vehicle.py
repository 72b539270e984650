"""Model of a car.

Dimensions of small and compact cars: length 3.6-4.5 m, width 1.65-1.82 m, height 1.45-1.55 m,
wheelbase about 0.61 of the length, ground clearance 0.15 m, wheels 0.60-0.65 m (data sheets of the
VW Polo and Golf, Toyota Yaris and Corolla). The car faces along x.
"""

import numpy as np

from jaxdet.sim.appearance import (
    BLACK,
    CHROME,
    GLASS,
    REFLECTIVE,
    RUBBER,
    SIGNAL_RED,
    STEEL,
    Texture,
)
from jaxdet.sim.mesh import Mesh, join, sheet
from jaxdet.sim.shapes import box, circle, fan, lathe, prism

PAINTS = ((214, 214, 212), (120, 124, 130), (26, 28, 32), (140, 22, 26), (28, 52, 110))


def vehicle(rng: np.random.Generator, phase: float = 0.0) -> Mesh:
    """Build a car with wheels, windows, lamps and plates."""
    del phase
    length, width, height = rng.uniform((3.6, 1.66, 1.45), (4.5, 1.82, 1.55)).tolist()
    paint = Texture("plain", PAINTS[int(rng.integers(5))], grain=2.0, gloss=0.45)
    parts = [_body(length, width, height, paint), *_cabin(length, width, height, paint)]
    for x in (0.305, -0.305):
        for side in (1, -1):
            parts += _wheel(x * length, side * width / 2)
    return join([*parts, *_trim(length, width, height)])


def _body(length: float, width: float, height: float, paint: Texture) -> Mesh:
    a, belt = length / 2, 0.60 * height
    outline = np.array(
        [[-0.96, 0.16], [0.95, 0.16], [1.0, 0.26], [1.0, 0.42], [0.94, 0.50], [0.50, belt / height],
         [-0.90, belt / height + 0.02], [-0.99, 0.50], [-1.0, 0.28]]
    )  # fmt: skip
    return prism(outline * (a, height), width, paint, bevel=0.10)


def _cabin(length: float, width: float, height: float, paint: Texture) -> list[Mesh]:
    """Build roof, pillars and glass: a tapered box with panes slightly outside of it."""
    belt, a = 0.59 * height, length / 2
    low_x, high_x = np.array([-0.93, 0.42]) * a, np.array([-0.72, 0.10]) * a
    low_y, high_y = 0.46 * width, 0.36 * width
    parts = [_frustum(low_x, high_x, low_y, high_y, belt, height, paint)]
    grow = 0.006
    for share in ((0.12, 0.86),):
        z = belt + (height - belt) * np.array(share)
        x = np.stack([low_x + (high_x - low_x) * s for s in share])
        y = np.array([low_y + (high_y - low_y) * s for s in share])
        inset = np.array([0.16, -0.16])
        split = x.mean(1)
        front, back = x.copy(), x.copy()
        front[:, 0], back[:, 1] = split + 0.03, split - 0.03
        for pane in (front + inset * (0, 1), back + inset * (1, 0)):
            for side in (1, -1):
                corners = [
                    [
                        [pane[i, 0], side * (y[i] + grow), z[i]],
                        [pane[i, 1], side * (y[i] + grow), z[i]],
                    ]
                    for i in (0, 1)
                ]
                parts.append(_pane(corners))
        for end, sign in ((1, 1), (0, -1)):
            corners = [
                [[x[i, end] + sign * 2 * grow, -0.88 * y[i], z[i]],
                 [x[i, end] + sign * 2 * grow, 0.88 * y[i], z[i]]]
                for i in (0, 1)
            ]  # fmt: skip
            parts.append(_pane(corners))
    return parts


def _pane(corners: list[list[list[float]]]) -> Mesh:
    return sheet(np.array(corners), GLASS)


def _frustum(
    low_x: np.ndarray, high_x: np.ndarray, low_y: float, high_y: float, low: float, high: float,
    texture: Texture,
) -> Mesh:  # fmt: skip
    def ring(x: np.ndarray, y: float, z: float) -> np.ndarray:
        return np.array([[x[0], -y, z], [x[1], -y, z], [x[1], y, z], [x[0], y, z]])

    a, b = ring(low_x, low_y, low), ring(high_x, high_y, high)
    sides = [_quad(a[i], a[j], b[j], b[i], texture) for i, j in ((0, 1), (1, 2), (2, 3), (3, 0))]
    return join([*sides, fan(b, texture)])


def _quad(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, texture: Texture) -> Mesh:
    return sheet(np.array([[a, b], [d, c]]), texture)


def _wheel(x: float, y: float, radius: float = 0.315) -> list[Mesh]:
    """Build a wheel that protrudes from a dark arch by a centimetre."""
    side = np.sign(y)
    turn = np.eye(4)
    turn[:3, :3] = [[1, 0, 0], [0, 0, -side], [0, side, 0]]
    turn[:3, 3] = x, y, radius
    tyre = lathe([(radius, 0.20), (radius, 0.02), (radius - 0.02, -0.01)], RUBBER, 40)
    parts = [
        tyre,
        fan(circle(radius - 0.02, -0.01, 40), RUBBER),
        fan(circle(0.21, -0.014, 32), STEEL),
    ]
    parts.append(fan(circle(0.06, -0.018, 20), CHROME))
    edge = circle(radius + 0.055, -0.004, 40)
    edge[:, 1] = np.clip(edge[:, 1] * side, -0.1, None) * side
    arch = fan(edge, BLACK)
    return [part.moved(turn) for part in [*parts, arch]]


def _trim(length: float, width: float, height: float) -> list[Mesh]:
    a = length / 2
    parts = [
        box((length * 0.97, width * 0.94, 0.12 * height), BLACK, (0, 0, 0.11 * height)),
        box((0.03, 0.46 * width, 0.10 * height), BLACK, (a - 0.01, 0, 0.30 * height)),
        box((0.03, 0.52, 0.11), REFLECTIVE, (a + 0.005, 0, 0.22 * height)),
        box((0.03, 0.52, 0.11), REFLECTIVE, (-a - 0.005, 0, 0.36 * height)),
    ]
    for side in (1, -1):
        y = side * 0.36 * width
        parts.append(box((0.08, 0.24 * width, 0.09 * height), CHROME, (a - 0.03, y, 0.40 * height)))
        parts.append(
            box((0.08, 0.18 * width, 0.12 * height), SIGNAL_RED, (-a + 0.03, y, 0.46 * height))
        )
        parts.append(
            box((0.13, 0.16, 0.11), BLACK, (0.40 * a, side * (0.5 * width + 0.05), 0.60 * height))
        )
    return parts
