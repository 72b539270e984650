"""The harder simulator: a worse depth camera, wrong mounts, scenes with walls, drops, ramps."""

import hashlib

import pytest

from jaxdet.sim import (
    HARD_FAMILIES,
    DepthSensor,
    load_scene,
    sample_frames,
)
from jaxdet.sim.render import render
from jaxdet.sim.robot import mount
from jaxdet.types import Intrinsics

SMALL = {"width": 160, "height": 120}
CAMERA = Intrinsics(640, 480, 384.5, 384.5, 321.7, 236.8)
SMALL_CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)
EXACT = DepthSensor(enabled=False)
QUIET = DepthSensor(dropout=0, speckle=0, noise_px=0)
OLD = {
    "mixed": "6e95e47b8ca5a0a75c21448a6e2563507798696ca2ac011efd5f19cc58e40bde",
    "low_things": "8f297c1638c938b9223a91c060d7e103f33f5a9936d7b0d28031c718939b3ed9",
}
"""SHA-256 of the images that figures measured on the clean simulator come from."""


@pytest.mark.parametrize("family", OLD)
def test_clean_frames_keep_their_bytes(family):
    digest = hashlib.sha256()
    for frame in sample_frames(family, 3, 2, depth_form="both", **SMALL):
        truth = frame.truth
        arrays = frame.color, frame.depth, frame.aligned, truth.obstacle_id, truth.depth
        for array in (*arrays, frame.T_world_color):
            digest.update(array.tobytes())
    assert digest.hexdigest() == OLD[family]


@pytest.mark.parametrize("family", HARD_FAMILIES)
def test_families_are_drawn_by_seed(family):
    scenes = [load_scene(family, seed) for seed in range(6)]
    assert len(set(scenes)) == 6 and scenes[2] == load_scene(family, 2)
    assert all(scene.walls for scene in scenes)
    # Nothing stands on the robot.
    for scene in scenes:
        near = render(scene, SMALL_CAMERA, mount(0.3, 0.17, 0.0), light=None).depth
        assert near.min() > 0.3
