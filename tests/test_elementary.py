"""Elementary functions: accuracy against 80-bit arithmetic, special values, stored tables."""

import hashlib
import math

import numpy as np
import pytest

from jaxdet import elementary
from jaxdet.config import FloorConfig
from jaxdet.floor.plane import direction_table
from jaxdet.floor.units import SINES, Scale, stride

NAN, INF = np.nan, np.inf
wide = np.finfo(np.longdouble).nmant > 60
needs_wide = pytest.mark.skipif(not wide, reason="long double is no wider than float64 here")


def ulps(found, true):
    """Return the largest error of float64 values in units in the last place (long double truth)."""
    spacing = np.spacing(np.abs(true.astype(np.float64)))
    return float(np.max(np.abs((found.astype(np.longdouble) - true) / spacing)))


def numbers(count=50_000):
    rng = np.random.default_rng(5)
    return rng.normal(size=(2, count)) * np.exp(rng.uniform(-9, 9, (2, count)))


ANGLES = np.concatenate(
    [
        np.linspace(-7, 7, 50_001),
        np.linspace(-1e6, 1e6, 50_001),
        np.arange(-720, 721) * np.pi / 360,  # near the zeros
        np.nextafter(np.arange(-8, 9) * np.pi / 2, 1),
        np.array([1e-300, -1e-9, -(2.0**20) * 1.57]),
    ]
)
LENGTHS = np.exp(np.concatenate([np.linspace(-700, 700, 50_001), np.linspace(-1e-3, 1e-3, 10_001)]))


@needs_wide
@pytest.mark.parametrize(
    ("function", "true", "arguments", "most"),
    [
        (elementary.sin, np.sin, [ANGLES], 1.0),
        (elementary.cos, np.cos, [ANGLES], 1.2),
        (elementary.arctangent, np.arctan, [np.abs(numbers()[0])], 2.0),
        (elementary.arctan2, np.arctan2, numbers(), 2.0),
        (elementary.hypot, np.hypot, numbers(), 1.3),
        (elementary.log, np.log, [LENGTHS], 1.0),
    ],
)
def test_errors_are_a_few_units_in_the_last_place(function, true, arguments, most):
    assert ulps(function(*arguments), true(*(np.longdouble(a) for a in arguments))) <= most


def assert_same(found, want):
    """Assert that values are equal, including NaN and the sign of zeros."""
    np.testing.assert_array_equal(found, want)
    given = ~np.isnan(want)
    assert (np.signbit(found) == np.signbit(want))[given].all()


def test_special_angles_are_exact():
    x = np.array([0.0, -0.0, INF, -INF, NAN])
    assert_same(elementary.sin(x), np.array([0.0, 0.0, NAN, NAN, NAN]))
    assert_same(elementary.cos(x), np.array([1.0, 1.0, NAN, NAN, NAN]))


def test_huge_angles_are_reduced_by_whole_turns():
    found = np.array(elementary.sin_cos(np.array([1e9, -1e300])))
    assert np.abs(found[0] ** 2 + found[1] ** 2 - 1).max() < 1e-15
    angles = np.array([1e9, 1e5, np.nan, 0.3])  # reduced independently
    assert_same(elementary.sin(angles), np.array([float(elementary.sin(a)) for a in angles]))


def test_arctan2_treats_special_values_as_numpy_does():
    values = np.array([0.0, -0.0, 1.0, -1.0, INF, -INF, NAN, 5e-324, 1e308])
    y, x = (a.ravel() for a in np.meshgrid(values, values))
    found, want = elementary.arctan2(y, x), np.arctan2(y, x)
    np.testing.assert_allclose(found, want, rtol=4e-16, atol=0)
    given = ~np.isnan(want)
    assert (np.signbit(found) == np.signbit(want))[given].all()


def test_other_functions_treat_special_values_as_numpy_does():
    x = np.array([1.0, 0.0, -0.0, -1.0, INF, -INF, NAN, 2.0])
    assert_same(elementary.log(x), np.array([0, -INF, -INF, NAN, INF, NAN, NAN, math.log(2)]))
    found = elementary.hypot([0.0, INF, NAN, 3e-320, 3e307], [-0.0, 1.0, 1.0, 4e-320, -4e307])
    np.testing.assert_allclose(found, [0.0, INF, NAN, 5e-320, 5e307], rtol=1e-3)


def test_scalars_are_accepted():
    assert float(elementary.sin(0.5)) == math.sin(0.5)
    assert float(elementary.hypot(3, 4)) == 5.0
    assert float(elementary.arctan2(1, 1)) == math.pi / 4


def test_matmul_equals_the_product_of_matrices():
    rng = np.random.default_rng(0)
    a, b, v = rng.normal(size=(5, 3, 4)), rng.normal(size=(4, 2)), rng.normal(size=4)
    np.testing.assert_allclose(elementary.matmul(a, b), a @ b, rtol=1e-13)
    np.testing.assert_allclose(elementary.dot(a, v), a @ v, rtol=1e-13)
    np.testing.assert_allclose(elementary.norm(a), np.linalg.norm(a, axis=-1), rtol=1e-15)


def test_sums_are_computed_in_order():
    terms = [1.0, 1e17, -1e17]  # the 1 is lost in this order
    assert elementary.dot(np.array(terms), np.ones(3)) == 0.0
    assert elementary.matmul(np.array([terms]), np.ones((3, 1)))[0, 0] == 0.0
    assert elementary.mean(np.array(terms)) == 0.0
    assert elementary.mean(np.array(terms), np.ones(3)) == 0.0


def test_means_and_medians_equal_those_of_numpy():
    values = np.array([[1.0, 4.0], [3.0, -4.0], [2.0, 0.0]])
    assert elementary.mean(values).tolist() == [2.0, 0.0]
    assert elementary.mean(values, np.array([1, 0, 3])).tolist() == [1.75, 1.0]
    assert elementary.median(values, axis=0).tolist() == [2.0, 0.0]
    assert not np.signbit(elementary.median(np.array([-0.0, -0.0, 0.0])))


@pytest.mark.parametrize(
    ("table", "digest"),
    [
        (SINES, "d54464d413d66a85744bed4f9baed64795dd69686ae0640bd63ceb74b2ecfd06"),
        (direction_table(), "558ea341aae6e5c632bcc02060b34ae9c52c1a4cf71372319ff565e57f0e59c7"),
    ],
)
def test_integer_tables_have_not_changed(table, digest):
    assert hashlib.sha256(np.ascontiguousarray(table, np.int64).tobytes()).hexdigest() == digest


def test_strides_and_powers_of_two_are_rounded_to_the_nearest():
    for metres in np.exp(np.linspace(-12, 3, 4001)).tolist():
        assert Scale(0.001, 0.0).bits(metres) == max(round(math.log2(metres / 0.001)), 0)
    config = FloorConfig()
    for cells in range(1, 200_000, 17):
        assert stride(cells, config) == max(1, math.ceil((cells / config.max_cells) ** 0.5))
