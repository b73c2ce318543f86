"""The table of a piecewise cubic against SciPy's own evaluation of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, PchipInterpolator, PPoly

from workcell.motion.cubic import Cubic

steps = st.lists(st.floats(1e-6, 2.0), min_size=2, max_size=8)


def curves(steps, coordinates: int):
    knots = np.concatenate([[0.0], np.cumsum(steps)])
    points = np.random.default_rng(len(steps)).uniform(-1, 1, (len(knots), coordinates))
    return CubicSpline(knots, points, bc_type="natural"), PchipInterpolator(knots, knots**2)


@settings(max_examples=50, deadline=None)
@given(steps, st.lists(st.floats(0.0, 1.0), min_size=1, max_size=10))
def test_it_is_the_curve_and_its_slope_everywhere(steps, parts):
    """At the knots too, where one piece ends and the next begins."""
    for curve in curves(steps, 7):
        table = Cubic(curve)
        assert table.end == curve.x[-1]
        terms = PPoly(np.abs(curve.c), curve.x)
        for at in [*curve.x, *(curve.x[-1] * np.array(parts))]:
            found = table.value_and_slope(float(at))
            assert table.value(float(at)) == found[0]
            for order, values in enumerate(found):
                # Rounding is of the size of the terms, which can be far larger than their sum.
                off = np.abs(values - np.atleast_1d(curve(at, order)))
                assert (off <= 1e-15 * np.atleast_1d(terms(at, order)) + 1e-300).all()


@pytest.mark.parametrize("beyond", [1e-18, 1e-12, 1.0, np.inf])
def test_beyond_its_ends_it_is_what_it_is_there(beyond):
    for curve in curves([0.3, 0.4, 0.5], 3):
        table = Cubic(curve)
        assert table.value_and_slope(-beyond) == table.value_and_slope(0.0)
        assert table.value_and_slope(table.end + beyond) == table.value_and_slope(table.end)


def test_two_knots_and_one_coordinate_are_a_curve():
    line = Cubic(PchipInterpolator([1.0, 3.0], [5.0, 9.0]))
    assert line.value_and_slope(2.0) == ([pytest.approx(7.0)], [pytest.approx(2.0)])


def test_a_place_that_is_not_a_number_has_no_value():
    value, slope = Cubic(curves([1.0, 1.0], 2)[0]).value_and_slope(np.nan)
    assert np.isnan([*value, *slope]).all()
