"""Scenes, models and scene files."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from jaxdet.errors import ConfigError, InputError
from jaxdet.sim import FAMILIES, SCENES, SimConfig, load_scene, read_scene, simulate, write_scene
from jaxdet.sim.mesh import shift
from jaxdet.sim.models import KINDS, LOW_THINGS, build_model
from jaxdet.sim.render import render
from jaxdet.sim.robot import mount, pose_at
from jaxdet.sim.scene import Model, Scene
from jaxdet.sim.world import outline
from jaxdet.types import Intrinsics

CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)
HEIGHTS = {
    "person": (1.4, 2.0), "walker": (1.4, 2.0), "vehicle": (1.4, 1.6), "barrier": (0.7, 0.95),
    "cone": (0.49, 1.01), "bucket": (0.24, 0.56), "bin": (0.35, 1.0), "tree_trunk": (3.0, 6.0),
    "street_light": (5.0, 6.3), "table": (0.71, 0.77), "chair": (0.7, 0.95),
    "sofa": (0.69, 0.91), "round_table": (0.69, 0.77), "cable_drum": (0.059, 0.21),
    "cart": (0.89, 1.13), "office_chair": (0.84, 1.11), "desk": (0.71, 1.3), "bed": (0.69, 1.11),
    "rack": (0.79, 1.91), "plant": (0.4, 1.75), "bag": (0.2, 0.65),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_can_be_rendered(name):
    scene = load_scene(name)
    view = render(scene, CAMERA, mount(0.3, 0.17, 0.02))
    assert np.isfinite(view.color).all() and view.obstacle_id.max() <= len(scene.objects)
    standing = len(scene.boxes) + len(scene.cylinders)
    seen = set(np.unique(view.obstacle_id)) & set(range(1, standing + 1))
    assert len(seen) == min(standing, 8)


def test_drive_passes_obstacles_and_a_person_crosses_in_front():
    scene = load_scene("drive")
    (person,) = scene.models
    times = np.arange(0, 10.01, 0.1)
    robot = np.array([pose_at(scene.path, time)[:2] for time in times])
    walker = np.array([pose_at(person.path, time)[:2] for time in times])
    standing = np.array([obj.center for obj in (*scene.boxes, *scene.cylinders)])
    assert robot[-1, 0] - robot[0, 0] == pytest.approx(5.0)
    passed = standing[standing[:, 0] < robot[-1, 0]]
    assert len(passed) >= 4 and {1.0, -1.0} == set(np.sign(passed[:, 1]))
    crossing = np.flatnonzero(np.diff(np.sign(walker[:, 1])))
    ahead = (walker - robot)[crossing, 0]
    assert len(ahead) == 1 and 1.0 < ahead[0] < 3.5  # visible to the camera
    for way in (walker[:, None], standing[None]):
        assert np.hypot(*(robot[:, None] - way).T).min() > 0.5  # room for the robot


@pytest.mark.parametrize("family", FAMILIES)
def test_scenes_of_each_family_show_obstacles(family):
    seen = 0
    for seed in range(3):
        scene = load_scene(family, seed, 1.5)
        view = render(scene, CAMERA, mount(0.3, 0.17, 0.02), light=None)
        seen += bool(((view.kind == 3).sum()) > 30)
    assert seen >= 2


@pytest.mark.parametrize("kind", KINDS)
def test_models_have_plausible_sizes(kind):
    for seed in range(4):
        mesh = build_model(kind, seed, 0.7 * seed)
        points = mesh.corners.reshape(-1, 3)
        low, high = HEIGHTS.get(kind, (0.018, 0.105))
        assert abs(points[:, 2].min()) < 0.003 and low <= points[:, 2].max() <= high
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1, atol=1e-9)
        assert np.isfinite(mesh.places).all() and np.ptp(points[:, :2], axis=0).max() < 4.6
        again = build_model(kind, seed, 0.7 * seed)
        assert (again.corners == mesh.corners).all() and again.textures == mesh.textures
        x, y = outline(mesh).T
        assert (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() > 0
    assert len(LOW_THINGS) == 6


def test_footprints_contain_the_parts_above_the_step_height():
    """The foot of a cone is lower than 5 cm; the footprint of a low object is complete."""
    cone = build_model("cone", 0, 0.0)
    points = cone.corners.reshape(-1, 3)
    x, y = outline(cone).T
    assert np.ptp(x) < 0.9 * np.ptp(points[:, 0]) and np.ptp(y) < 0.9 * np.ptp(points[:, 1])
    raised = cone.moved(shift(0.0, 0.0, 1.0))
    np.testing.assert_allclose(outline(raised, 1.0), outline(cone), atol=1e-6)
    low = cone.scaled(0.04 / points[:, 2].max())
    np.testing.assert_allclose(
        np.ptp(outline(low), axis=0), np.ptp(low.corners.reshape(-1, 3)[:, :2], axis=0), atol=1e-6
    )


def test_unknown_models_are_errors():
    with pytest.raises(ConfigError, match="unknown model 'dragon'"):
        render(Scene(models=(Model("dragon"),)), CAMERA, mount(0.3, 0.17, 0.02))


@pytest.mark.parametrize("name", ["demo", "mixed", "pedestrian", "tree_trunk"])
def test_scene_files_survive_a_round_trip(tmp_path, name):
    scene = load_scene(name, 4)
    (tmp_path / "scene.json").write_text(json.dumps(asdict(scene)))
    assert load_scene(str(tmp_path / "scene.json")) == scene
    write_scene(scene, tmp_path / "scene.toml")
    assert read_scene(tmp_path / "scene.toml") == scene
    with pytest.raises(InputError, match="can't be written"):
        write_scene(scene, tmp_path)


def test_a_scene_file_written_by_hand_is_read(tmp_path):
    toml = 'name = "one"\nwalls = []\n[[boxes]]\ncenter = [1.5, 0]\nsize = [0.3, 0.3, 0.4]\n'
    toml += '[boxes.texture]\nkind = "stripes"\ncolor = [200, 0, 0]\n'
    (tmp_path / "one.toml").write_text(toml)
    scene = load_scene(str(tmp_path / "one.toml"))
    assert scene.boxes[0].texture.color == (200, 0, 0)
    config = SimConfig(scene=str(tmp_path / "one.toml"), frames=1, width=64, height=48)
    assert next(simulate(config)).truth.obstacle_id.any()


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("nonsense = 1", ConfigError), ("boxes = 3", ConfigError), ("[[boxes]]\n", ConfigError),
        ("[floor]\nshade = 1", ConfigError), ("= 1", InputError), (None, InputError),
    ],
)  # fmt: skip
def test_bad_scene_files_are_errors(tmp_path, text, error):
    path = tmp_path / "scene.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(error, match=r"scene\.toml"):
        load_scene(str(path))


def test_unknown_scenes_are_errors():
    with pytest.raises(ConfigError, match="unknown scene 'attic'"):
        load_scene("attic")
