"""Sensor model of the colour camera, from surfaces and light to the image.

1. A display value c has the reflectance ``0.9 sRGB^-1(c / 255)``.
2. The illuminance of a surface by ambient light and the lamp is ``E = lux ((1 - lamp) + lamp
   cos / cos_floor)``, with the cosines of the lamp's direction on the surface and on the level
   floor. Reflection is Lambertian; gloss adds a specular reflection of the lamp.
3. The illuminance of the sensor is ``E_s = E rho T / (4 N^2)``, with the reflectance rho, the
   transmission T of the lens and its f-number N (Holst, "CMOS/CCD Sensors and Camera Systems",
   equation for a distant extended source), reduced by vignetting.
4. In the time t a pixel collects ``E_s t k`` electrons, where ``k`` is the product of the pixel
   area, the quantum efficiency behind the colour filters and 4.1e15 photons / (s m2 lux): 1 W of
   light at 555 nm is 683 lm by definition of the candela.
5. Photon noise (Poisson, in its normal limit), read noise, full well and gain follow.
6. Auto exposure brings the mean of the image to ``target``: first by the time, limited by the frame
   rate, then by the gain up to its limit. Beyond that the image darkens.
7. The processor smooths more at higher gain, and encodes in sRGB with a tone curve and 8 bits.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import numpy as np

from jaxdet.types import Intrinsics

TRANSMISSION = 0.9
"""Transmission T of a coated lens."""
LightName = Literal["strong", "normal", "weaker", "dim"]


class Illumination(NamedTuple):
    """Illumination of a scene."""

    lux: float
    """Illuminance of the level floor [lux]."""
    lamp: float
    """Fraction of the light that comes from the lamp; the rest is ambient."""
    softness: float
    """Radius of the lamp's disc at unit distance."""
    samples: int
    """Shadow rays per pixel."""


LIGHTS: dict[LightName, Illumination] = {
    "strong": Illumination(30_000.0, 0.82, 0.005, 1),
    "normal": Illumination(500.0, 0.50, 0.08, 2),
    "weaker": Illumination(120.0, 0.60, 0.06, 2),
    "dim": Illumination(50.0, 0.60, 0.06, 2),
}
"""The paper's four light levels. The paper gives no figures; those assumed are, in this order: sun
through thin cloud (10-100 klx outdoors); an office (500 lx, EN 12464-1); a corridor (100 lx, EN
12464-1); a room at dusk or a street at night (5-50 lx, EN 13201 class C), with exposure and gain at
their limits."""


@dataclass(frozen=True)
class ColorSensor:
    """Colour camera; the defaults approximate a D435i (OV2740, 1920 x 1080, 1.4 um, f/2.0)."""

    enabled: bool = True
    """Simulate noise, blur and vignetting; off: only light and exposure."""
    f_number: float = 2.0
    """F-number of the lens."""
    pixel_um: float = 3.15
    """Side of an output pixel on the sensor [um]: that of a sensor pixel, 1.4 um, times 1080 / 480,
    as 1080 rows of the sensor become 480 rows of the image."""
    efficiency: float = 0.30
    """Quantum efficiency behind the colour filters [electrons per photon]."""
    read_noise_e: float = 6.0
    """Read noise of an output pixel [electrons]."""
    full_well_e: float = 25_000.0
    """Full well capacity of an output pixel [electrons]."""
    max_exposure_s: float = 1 / 30
    """Maximum exposure time [s]."""
    max_gain: float = 16.0
    """Maximum gain."""
    target: float = 0.18
    """Mean brightness of the image that auto exposure aims at, linear, 1 = saturated."""
    blur_px: float = 0.55
    """Blur of lens and demosaicing [pixel]."""
    smooth_px: float = 0.22
    """Smoothing per doubling of the gain [pixel]."""
    contrast: float = 1.3
    """Slope of the S-shaped tone curve at middle grey, in display values; chosen so that images of
    ``mixed`` in normal light have the contrast of ten real D435 images (standard deviation 48
    levels, mean 109) and their edge sharpness (a third of the step per pixel)."""
    vignetting: float = 0.5
    """Fraction of the cos^4 law that remains after the camera's correction."""


def expose(
    surface: tuple[np.ndarray, np.ndarray],
    camera: Intrinsics,
    light: Illumination,
    cos_floor: float,
    sensor: ColorSensor,
    rng: np.random.Generator,
    smear_px: float = 0.0,
) -> np.ndarray:
    """Simulate a colour image.

    Args:
        surface: ``color`` and ``light`` of a :class:`jaxdet.sim.render.Rendering`.
        camera: Colour camera.
        light: Illumination.
        cos_floor: Cosine of the lamp's direction on the level floor.
        sensor: Sensor, lens and processor of the camera.
        rng: Random generator.
        smear_px: Horizontal motion blur at the maximum exposure time [pixel].

    Returns:
        Image ``(H, W, 3)`` uint8, RGB.
    """
    lux = illuminate(*surface, light, cos_floor) * np.float32(
        TRANSMISSION / (4 * sensor.f_number**2)
    )
    if sensor.enabled:
        lux *= _vignette(camera, sensor.vignetting)[..., None]
        lux = cv2.GaussianBlur(lux, (7, 7), sensor.blur_px)
    rate = 4.1e15 * (sensor.pixel_um * 1e-6) ** 2 * sensor.efficiency
    wanted = sensor.target * sensor.full_well_e / (rate * max(float(lux.mean()), 1e-9))
    time_s = min(sensor.max_exposure_s, wanted)
    gain = float(np.clip(wanted / time_s, 1.0, sensor.max_gain))
    electrons = lux * np.float32(rate * time_s)
    if sensor.enabled:
        electrons = _smear(electrons, smear_px * time_s / sensor.max_exposure_s)
        spread = np.sqrt(electrons + np.float32(sensor.read_noise_e**2))
        electrons += spread * rng.standard_normal(electrons.shape, np.float32)
        width = sensor.smooth_px * np.log2(gain)
        if width > 0.1:
            electrons = cv2.GaussianBlur(electrons, (9, 9), width)
    linear = np.minimum(electrons, sensor.full_well_e) * np.float32(gain / sensor.full_well_e)
    return _encode(linear, sensor.contrast if sensor.enabled else 1.0)


def illuminate(
    color: np.ndarray, shine: np.ndarray, light: Illumination, cos_floor: float
) -> np.ndarray:
    """Return the light reflected by surfaces, ``(H, W, 3)`` float32 [lux times reflectance]."""
    lamp = np.float32(light.lux * light.lamp / cos_floor)
    got = np.float32(light.lux * (1 - light.lamp)) + lamp * shine[..., :1]
    return reflectance_of(color) * got + lamp * shine[..., 1:2]


def reflectance_of(color: np.ndarray) -> np.ndarray:
    """Return the reflectance, float32, of colours [grey levels], which are rounded to a quarter."""
    table = (0.9 * _linear(np.arange(1021) / 1020)).astype(np.float32)
    return table[np.clip(color * np.float32(4) + np.float32(0.5), 0, 1020).astype(np.uint16)]


def _linear(value: np.ndarray) -> np.ndarray:
    """Decode sRGB, IEC 61966-2-1."""
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def _encode(linear: np.ndarray, contrast: float) -> np.ndarray:
    steps = np.arange(4096) / 4095
    curve = np.where(steps <= 0.0031308, steps * 12.92, 1.055 * steps ** (1 / 2.4) - 0.055)
    toned = curve - (contrast - 1) / (2 * np.pi) * np.sin(2 * np.pi * curve)
    table = np.rint(255 * toned).astype(np.uint8)
    return table[np.clip(linear * np.float32(4095) + np.float32(0.5), 0, 4095).astype(np.uint16)]


def _vignette(camera: Intrinsics, part: float) -> np.ndarray:
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    cos2 = 1 / (1 + x[None, :] ** 2 + y[:, None] ** 2)
    return (cos2 ** (2 * part)).astype(np.float32)


def _smear(image: np.ndarray, length_px: float) -> np.ndarray:
    """Blur horizontally by a box of this length, with fractional ends."""
    if length_px < 0.2:
        return image
    half = int(np.ceil(length_px / 2))
    places = np.arange(-half, half + 1)
    taps = np.clip(length_px / 2 + 0.5 - np.abs(places), 0, 1)
    return cv2.filter2D(image, -1, (taps / taps.sum())[None].astype(np.float32))
