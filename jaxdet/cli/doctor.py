"""``jaxdet doctor``: reports versions and devices, and compares the backends on a small case."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import jaxdet
from jaxdet.cli.flags import parse_flags
from jaxdet.cli.terminal import SPINNER, tell

DESCRIPTION = """\
Checks this installation: versions, the devices of JAX and Warp, and whether the compiled
program returns the same arrays as the NumPy reference on a small built-in case.
"""


@dataclass(frozen=True)
class DoctorCommand:
    """Arguments of ``jaxdet doctor``."""

    json: bool = False
    """Print the report as JSON."""


def main(args: list[str]) -> int:
    """Run the command; return 0 if all checks pass, else 1."""
    command = parse_flags(DoctorCommand, args, "jaxdet doctor", DESCRIPTION)
    with SPINNER.shown("comparing; the first run compiles the kernels"):
        from jaxdet.engine import start_up
        from jaxdet.results.json_files import to_json
        from jaxdet.results.versions import versions

        start_up()
        about = {"jaxdet": jaxdet.__version__, **versions()}
        checks = {name: _checked(check) for name, check in CHECKS.items()}
    failed = [name for name, (passed, _) in checks.items() if not passed]
    if command.json:
        report = {name: {"ok": ok, "found": text} for name, (ok, text) in checks.items()}
        print(to_json({"versions": about, "checks": report, "ok": not failed}), end="")
        return 1 if failed else 0
    for name, version in about.items():
        print(f"{name:<24} {version or 'not installed'}")
    for name, (passed, text) in checks.items():
        print(f"{name:<24} {'ok' if passed else 'FAILED'}: {text}")
    if failed:
        tell(f"jaxdet: error: failed: {', '.join(failed)}")
    return 1 if failed else 0


def _checked(check: Any) -> tuple[bool, str]:
    try:
        return check()
    except Exception as error:
        return False, f"{type(error).__name__}: {' '.join(str(error).split())}"


def jax_devices() -> tuple[bool, str]:
    """List the devices of JAX."""
    import jax

    found = jax.devices()
    text = ", ".join(f"{d.platform}:{d.id} {d.device_kind}" for d in found)
    if gpu_is_visible() and all(device.platform == "cpu" for device in found):
        text += "; an NVIDIA GPU is unused; run pip install 'jaxdet[cuda13]'"
    return True, text


def gpu_is_visible() -> bool:
    """Return whether the system has an NVIDIA GPU."""
    return Path("/dev/nvidia0").exists() or shutil.which("nvidia-smi") is not None


def warp_devices() -> tuple[bool, str]:
    """List the devices of Warp."""
    import warp

    warp.init()
    return True, ", ".join(f"{device.alias} {device.name}" for device in warp.get_devices())


def backends_agree() -> tuple[bool, str]:
    """Compare the arrays of both backends on a small case."""
    from jax import tree

    from jaxdet.pipeline import detect

    frames = small_case()
    both = [detect(frames, backend=name) for name in ("reference", "jax")]
    wrong = []
    for part in ("num_obstacles", "obstacles", "scene"):
        pairs = zip(*(tree.leaves(getattr(found, part)) for found in both), strict=True)
        wrong += [part] * any(not np.array_equal(np.asarray(a), np.asarray(b)) for a, b in pairs)
    count = int(np.asarray(both[0].num_obstacles).sum())
    if wrong:
        return False, f"differ in {', '.join(wrong)}"
    return count > 0, f"equal arrays, {count} obstacles"


def kernels_answer() -> tuple[bool, str]:
    """Run the kernels on test images and compare the results with stored results."""
    from jaxdet.stages import check_kernels

    check_kernels()
    return True, "equal to the stored result"


def small_case() -> "jaxdet.Frames":
    """Return two 160 x 120 depth images of a box in front of a wall, with a level camera."""
    v, u = np.mgrid[0:120, 0:160]
    box = (u >= 50) & (u < 110) & (v >= 30) & (v < 80)
    depth = np.where(box, 1200, 3000).astype(np.uint16)
    camera = jaxdet.Intrinsics(160, 120, 120.0, 120.0, 80.0, 60.0)
    still = jaxdet.Extrinsics((1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0), (0.015, 0.0, 0.0))
    stamps = np.array([0, 33_000_000])
    level = jaxdet.flat_plane(np.full(2, 0.5), np.zeros(2), np.zeros(2))
    return jaxdet.Frames(
        np.stack([depth, depth[:, ::-1]]),
        jaxdet.Calibration(camera, camera, still),
        np.arange(2),
        stamps,
        np.ones(2, bool),
        plane=level,
    )


def caches() -> tuple[bool, str]:
    """Check the folders in which compiled programs are cached."""
    from jaxdet.engine.startup import NOT_KEPT, UNSAFE, cache_folders, unsafe_caches, use_caches

    found, used = cache_folders(), use_caches()
    for folder in unsafe_caches():
        return False, f"{folder} {UNSAFE}"
    unusable = next((folder for folder in found if folder and folder not in used), None)
    if unusable:
        return False, f"{unusable} {NOT_KEPT}"
    named = (f"{name} {path or 'not cached'}" for name, path in used._asdict().items())
    return True, ", ".join(named)


CHECKS = {
    "jax devices": jax_devices,
    "warp devices": warp_devices,
    "caches": caches,
    "kernels": kernels_answer,
    "backends agree": backends_agree,
}
