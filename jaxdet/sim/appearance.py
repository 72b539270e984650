"""Textures of floors, walls and objects.

Colours are display values; :mod:`jaxdet.sim.exposure` derives the Lambertian reflectance.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

Color = tuple[int, int, int]
"""Red, green and blue, 0 to 255, in sRGB."""
Kind = Literal[
    "plain", "noise", "tiles", "wood", "stripes", "checker", "carton", "cloth", "bark", "brick",
    "lines", "asphalt", "grass", "mosaic",
]  # fmt: skip
"""Names of the patterns."""


@dataclass(frozen=True)
class Texture:
    """Appearance of a surface in the colour and infrared cameras."""

    kind: Kind = "plain"
    """Pattern of the two colours."""
    color: Color = (150, 150, 150)
    """Main colour."""
    accent: Color = (90, 90, 90)
    """Colour of joints, stripes, prints."""
    size_m: float = 0.3
    """Period of the pattern [m]: tile, board, stripe pair, carton face."""
    grain: float = 3.0
    """Standard deviation of the fine noise [grey levels]."""
    gloss: float = 0.0
    """Specular reflectance, 0 to 1: highlights in colour, holes in depth; a level floor with gloss
    mirrors the objects on it."""
    clear: float = 0.0
    """Transparency, 0 to 1; depth is measured through the surface."""


TILES = Texture("tiles", color=(150, 146, 138), accent=(70, 68, 66), size_m=0.4, grain=3.0)
WOOD = Texture("wood", color=(172, 128, 84), accent=(84, 56, 34), size_m=0.14, grain=3.0)
CARPET = Texture("noise", color=(96, 108, 120), accent=(150, 158, 166), size_m=0.25, grain=5.0)
PLASTER = Texture("noise", color=(164, 160, 150), accent=(148, 144, 136), size_m=1.0, grain=1.5)
CARTON = Texture("carton", color=(226, 190, 140), accent=(92, 60, 34), size_m=0.35)
DARK_CASE = Texture("checker", color=(28, 30, 36), accent=(70, 74, 82), size_m=0.2, grain=4.0)
RED_CRATE = Texture("stripes", color=(150, 24, 28), accent=(40, 8, 12), size_m=0.12, grain=4.0)
BLUE_BIN = Texture("stripes", color=(24, 50, 128), accent=(226, 230, 236), size_m=0.3, grain=4.0)
POST = Texture("stripes", color=(238, 236, 230), accent=(176, 20, 22), size_m=0.24, grain=3.0)
BUCKET = Texture("stripes", color=(24, 90, 40), accent=(10, 36, 18), size_m=0.16, grain=4.0)
WHITE_BOX = Texture("carton", color=(238, 238, 236), accent=(40, 44, 60), size_m=0.4)

CHECKERED = Texture("checker", color=(176, 172, 164), accent=(82, 80, 78), size_m=0.6, grain=3.0)
MOSAIC = Texture("mosaic", color=(150, 140, 126), accent=(70, 74, 84), size_m=0.3, grain=4.0)
MARKED = Texture("lines", color=(92, 94, 96), accent=(214, 208, 190), size_m=1.5, grain=5.0)
ASPHALT = Texture("asphalt", color=(88, 88, 90), accent=(170, 168, 164), size_m=0.25, grain=6.0)
PAVING = Texture("brick", color=(142, 128, 116), accent=(78, 74, 70), size_m=0.22, grain=5.0)
GRASS = Texture("grass", color=(62, 84, 40), accent=(120, 136, 72), size_m=0.3, grain=6.0)
HEDGE = Texture("grass", color=(34, 56, 28), accent=(96, 120, 60), size_m=0.12, grain=9.0)
BRICK_WALL = Texture("brick", color=(150, 84, 66), accent=(178, 170, 160), size_m=0.16, grain=5.0)
CONCRETE = Texture("noise", color=(150, 150, 148), accent=(130, 130, 128), size_m=0.8, grain=3.0)

PLAIN_FLOOR = Texture("plain", color=(142, 142, 138), grain=0.8)
SCREED = Texture("noise", color=(128, 128, 124), accent=(116, 116, 112), size_m=1.2, grain=1.0)
EPOXY = Texture("plain", color=(120, 126, 128), grain=0.6, gloss=0.35)
LINOLEUM = Texture("noise", (136, 126, 108), (120, 110, 94), size_m=0.6, grain=1.5, gloss=0.25)
POLISHED = Texture("tiles", (176, 172, 166), (134, 130, 126), size_m=0.6, grain=1.5, gloss=0.45)
PAINT = Texture("plain", color=(186, 182, 172), grain=1.0)
WET = Texture("asphalt", (62, 62, 64), (120, 120, 122), size_m=0.25, grain=4.0, gloss=0.4)
DOOR = Texture("plain", color=(146, 112, 78), grain=2.0)
CLEAR_GLASS = Texture("plain", color=(150, 160, 160), grain=0.5, gloss=0.3, clear=0.85)

HARD_FLOORS = (PLAIN_FLOOR, SCREED, EPOXY, LINOLEUM, POLISHED)
INDOOR_FLOORS = (TILES, WOOD, CARPET, CHECKERED, MOSAIC, MARKED)
OUTDOOR_FLOORS = (ASPHALT, PAVING, MARKED, GRASS)
WALLS = (PLASTER, BRICK_WALL, CONCRETE)

RUBBER = Texture("plain", color=(34, 34, 36), grain=2.0)
CHROME = Texture("plain", color=(176, 178, 182), grain=1.0, gloss=0.7)
STEEL = Texture("plain", color=(128, 130, 134), grain=2.0, gloss=0.25)
GLASS = Texture("plain", color=(30, 36, 42), grain=1.0, gloss=0.9)
BLACK = Texture("plain", color=(20, 20, 22), grain=2.0)
REFLECTIVE = Texture("plain", color=(236, 236, 238), grain=2.0, gloss=0.2)
SIGNAL_ORANGE = Texture("plain", color=(226, 74, 24), grain=3.0)
SIGNAL_RED = Texture("plain", color=(190, 28, 26), grain=3.0)


def pick(rng: np.random.Generator, *textures: Texture) -> Texture:
    """Draw one of the textures."""
    return textures[int(rng.integers(len(textures)))]


def tinted(
    rng: np.random.Generator, color: tuple[int, int, int], spread: float = 18.0
) -> tuple[int, int, int]:
    """Draw a colour near another.

    The standard deviation of the brightness is ``spread`` [grey levels]; a quarter of ``spread`` is
    added independently to each channel.
    """
    moved = np.asarray(color) + rng.normal(0, spread) + rng.normal(0, spread / 4, 3)
    r, g, b = np.clip(moved, 8, 245).astype(int).tolist()
    return r, g, b
