"""footprint: examples by hand, and comparison of kernel and reference.

Rectangles are tested in ``tests/test_metric.py``.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxdet import reference, stages
from jaxdet.config import ClusterConfig, Config, FootprintConfig
from jaxdet.errors import ConfigError
from jaxdet.floor.plane import ground_axes
from jaxdet.presets import PRESETS
from jaxdet.reference.paper._footprint import to_ground
from jaxdet.results.metric import point_distances, rectangles
from jaxdet.stages.paper._footprint import to_ground as to_ground_twin
from jaxdet.types import MAX_LATERAL, Features, Labels
from tests.scenes import assert_equal, level, points

BACKENDS = pytest.mark.parametrize("backend", [reference, stages], ids=["reference", "stages"])
PAPER = PRESETS["paper"].footprint
CONFIG = replace(Config(), footprint=PAPER, cluster=ClusterConfig(points=True, min_points=0))


SLOTS = 32


def measure(backend, x, z, labels, config=CONFIG):
    """Return the obstacles of a frame, padded with points so that all cases share one program."""
    x, z = (np.pad(values, (0, SLOTS - len(values))) for values in (x, z))
    labels = np.pad(np.array(labels, np.int32), (0, SLOTS - len(labels)), constant_values=-1)
    found = Labels(labels[None], np.array([labels.max() + 1], np.int32))
    return backend.paper.footprint(points(x, z), found, level(1), 0.001, config)


# by hand


@BACKENDS
def test_extents_and_points_of_obstacles_match_a_hand_calculation(backend):
    found = measure(backend, [-300, 0, 200, 999], [1500, 1000, 1400, 700], [0, 0, 0, -1])
    assert np.asarray(found.num_points)[0].tolist() == [3, *[0] * (SLOTS - 1)]
    assert np.asarray(found.xyz_min)[0, 0].tolist() == [-300, 0, 1000]
    assert np.asarray(found.xyz_max)[0, 0].tolist() == [200, 0, 1500]
    assert np.asarray(found.xyz_sum)[0, 0].tolist() == [[-1, 65436], [0, 0], [0, 3900]]
    assert np.asarray(found.uv_min)[0, 0].tolist() == [0, 0]
    assert np.asarray(found.uv_max)[0, 0].tolist() == [2, 0]
    assert np.asarray(found.a)[0, 0].tolist() == [-300, 1500]
    assert np.asarray(found.b)[0, 0].tolist() == [200, 1400]
    assert np.asarray(found.c)[0, 0].tolist() == [0, 1000]
    assert np.asarray(found.has_vertex)[0].tolist() == [True, *[False] * (SLOTS - 1)]


@BACKENDS
def test_a_vertex_must_exceed_the_threshold(backend):
    """Eq. 7: no vertex while min(d_A, d_B) - d_C < d_threshold (30 mm)."""
    for nearest, vertex in ((971, False), (970, True)):
        found = measure(backend, [-100, 0, 100], [1000, nearest, 1200], [0, 0, 0])
        assert bool(np.asarray(found.has_vertex)[0, 0]) is vertex


@BACKENDS
def test_ties_are_resolved_to_the_nearer_and_left_point(backend):
    x, z = [-100, -100, 100, 100, 0, -50], [900, 800, 700, 950, 600, 600]
    found = measure(backend, x, z, [0] * 6)
    assert np.asarray(found.a)[0, 0].tolist() == [-100, 800]
    assert np.asarray(found.b)[0, 0].tolist() == [100, 700]
    assert np.asarray(found.c)[0, 0].tolist() == [-50, 600]


@BACKENDS
def test_the_nearest_point_may_differ_from_a_b_and_c(backend):
    x, z = [-300, 300, 290, 0], [1500, 1400, 1000, 1010]
    found = measure(backend, x, z, [0] * 4)
    assert np.asarray(found.c)[0, 0].tolist() == [290, 1000]
    assert np.asarray(found.nearest)[0, 0].tolist() == [*divmod(1010**2, 1 << 18)]
    assert point_distances(found)[0].tolist() == [1010.0, *[0.0] * (SLOTS - 1)]


@BACKENDS
def test_the_nearest_point_is_exact_at_the_largest_coordinates(backend):
    x, z = [MAX_LATERAL, MAX_LATERAL - 1], [65535, 65535]
    found = measure(backend, x, z, [0, 0])
    high, low = np.asarray(found.nearest)[0, 0].tolist()
    assert (high << 18) + low == (MAX_LATERAL - 1) ** 2 + 65535**2


def test_points_of_a_tilted_camera_are_projected_to_the_floor():
    pitch = np.radians(25.0)
    plane = level(1, 0.6, pitch)
    # A vertical pole 1.5 m ahead, from the floor to 1 m, projects to one point on the floor.
    height = np.linspace(0.0, 1.0, 11)
    forward, down = 1500.0, 600.0 - 1000 * height
    y = -forward * np.sin(pitch) + down * np.cos(pitch)
    z = forward * np.cos(pitch) + down * np.sin(pitch)
    features = points(0 * height, np.rint(z))._replace(y=np.rint(y).astype(np.int32)[None])
    assert np.abs(to_ground(features, plane)[0] - [0, 1500]).max() <= 1


def test_values_out_of_range_are_errors_that_name_the_flag():
    with pytest.raises(ConfigError, match=r"footprint\.extension-m"):
        FootprintConfig(extension_m=0)


def test_defaults_give_the_rectangle_of_the_paper():
    found = measure(reference, [-300, 0, 200], [1500, 1000, 1400], [0, 0, 0])
    plain = rectangles(found, 0.001, PRESETS["paper"].footprint)[0, 0]
    assert np.allclose(plain[:2], [[-0.3, 1.5], [0.2, 1.4]])


def outline(trim=0, side=0.0, near=0.0):
    return FootprintConfig(trim=trim, side_band_per_m=side, near_band_per_m2=near)


@BACKENDS
@pytest.mark.parametrize(
    ("settings", "a", "b", "c"),
    [
        (outline(), -160, 150, 1000),
        (outline(trim=1), -150, 140, 1010),
        # At most a sixteenth of the points is trimmed: 2 of 32.
        (outline(trim=9), -140, 130, 1020),
        # At 1 m, the bands contain five points at each side, and three in front.
        (outline(side=0.04, near=0.025), -140, 130, 1010),
        (outline(trim=2, side=0.04, near=0.035), -120, 110, 1030),
    ],
)
def test_trimmed_points_and_medians_match_a_hand_calculation(backend, settings, a, b, c):
    x = np.arange(32) * 10 - 160
    z = 1000 + 10 * ((np.arange(32) * 7) % 32)
    found = measure(backend, x, z, [0] * 32, config=replace(CONFIG, footprint=settings))
    assert np.asarray(found.a)[0, 0].tolist() == [a, z[x == a][0]]
    assert np.asarray(found.b)[0, 0].tolist() == [b, z[x == b][0]]
    assert np.asarray(found.c)[0, 0].tolist() == [x[z == c][0], c]


@BACKENDS
def test_the_band_in_front_grows_with_distance_squared(backend):
    """Of points 10 mm apart, a band of 12 mm at 1 m has two, and one of 48 mm at 2 m has five."""
    config = replace(CONFIG, footprint=outline(near=0.012))
    for z, c in ((1000, 1000), (2000, 2020)):
        found = measure(backend, np.arange(11), z + 10 * np.arange(11), [0] * 11, config=config)
        assert np.asarray(found.c)[0, 0].tolist() == [(c - z) // 10, c]


# twin


def hostile_features(seed: int, batch: int, n: int) -> tuple[Features, Labels]:
    rng = np.random.default_rng(seed)
    z = rng.integers(0, 65536, (batch, n))
    features = points(rng.integers(-4, 5, (batch, n)) * z, z)
    uv = rng.integers(0, 1280, (2, batch, n)).astype(np.int32)
    y = (rng.integers(-4, 5, (batch, n)) * z).astype(np.int32)
    features = features._replace(u=uv[0], v=uv[1], y=y)
    labels = rng.integers(-1, 4, (batch, n)).astype(np.int32)
    return features, Labels(labels, np.full(batch, 4, np.int32))


@pytest.mark.twin
@pytest.mark.parametrize(
    "settings",
    [outline(), FootprintConfig(), outline(trim=8192), outline(2, 0.1), outline(0, 1.0, 1.0)],
)
@pytest.mark.parametrize(("batch", "n"), [(3, 300), (1, 8192)])
def test_footprints_equal_the_reference_with_any_settings(device, batch, n, settings):
    plane = level(batch, 0.5, 0.3, -0.2)
    plane.pitch[-1], plane.valid[0] = -0.1, False
    config = replace(CONFIG, footprint=settings)
    unit = (0.001, 0.0001, 0.02)[n % 3]
    given_ = *hostile_features(n, batch, n), plane, unit, config
    want = reference.paper.footprint(*given_)
    assert (want.num_points[:, :4] > 0).all()
    assert_equal(stages.paper.footprint(*given_), want)


@pytest.mark.twin
def test_footprints_equal_the_reference_without_obstacles(device):
    features, labels = hostile_features(0, 3, 300)
    none = Labels(np.full_like(labels.labels, -1), np.zeros(3, np.int32))
    given_ = features, none, level(3), 0.001, CONFIG
    assert_equal(stages.paper.footprint(*given_), reference.paper.footprint(*given_))


@given(st.integers(0, 2**32 - 1), st.floats(-1.5, 1.5), st.floats(-3, 3))
@settings(max_examples=50)
def test_ground_coordinates_stay_in_32_bits(seed, pitch, roll):
    features, _ = hostile_features(seed, 1, 64)
    plane = level(1, 0.5, pitch, roll)
    xyz = np.stack([features.x, features.y, features.z], axis=-1)
    axes = ground_axes(plane)
    assert np.array_equal(np.asarray(to_ground_twin(xyz, axes)), to_ground(features, plane))


# laws


def test_permuting_labels_permutes_rows(device):
    features, labels = hostile_features(7, 3, 300)
    swap = np.array([3, 1, 2, 0, -1], np.int32)
    moved = Labels(swap[labels.labels], labels.num_obstacles)
    before = stages.paper.footprint(features, labels, level(3), 0.001, CONFIG)
    after = stages.paper.footprint(features, moved, level(3), 0.001, CONFIG)
    for was, now in zip(before, after, strict=True):
        assert np.array_equal(np.asarray(now)[:, [0, 3]], np.asarray(was)[:, [3, 0]])
