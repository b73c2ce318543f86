"""Datagrams come back as they were sent; anything else is none of ours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workcell.robot import wire

NUMBERS = arrays(float, 3, elements=st.floats(-1e3, 1e3))


@given(st.integers(0, 2**60), st.integers(-1, 2**60), st.integers(0, 2), NUMBERS, NUMBERS)
def test_states_come_back(sequence, acted_on, stopped, position, velocity):
    sent = wire.StateDatagram(sequence, acted_on, stopped, position, velocity)
    got = wire.state(sent.pack(), 3)
    assert (got.sequence, got.acted_on, got.stopped) == (sequence, acted_on, stopped)
    np.testing.assert_array_equal(got.position, position)
    np.testing.assert_array_equal(got.velocity, velocity)


@given(st.integers(-1, 2**60), st.booleans(), NUMBERS)
def test_commands_come_back(number, stop, velocity):
    got = wire.command(wire.CommandDatagram(number, stop, velocity).pack(), 3)
    assert (got.number, got.stop) == (number, stop)
    np.testing.assert_array_equal(got.velocity, velocity)


@given(st.binary(max_size=200))
def test_noise_is_left_out(datagram):
    assert wire.state(datagram, 3) is None
    assert wire.command(datagram, 3) is None


@pytest.mark.parametrize("joints", [2, 4])
def test_another_number_of_joints_is_left_out(joints):
    sent = wire.StateDatagram(1, 1, 0, np.zeros(joints), np.zeros(joints))
    assert wire.state(sent.pack(), 3) is None


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_left_out(value):
    bad = np.array([0.0, value, 0.0])
    assert wire.state(wire.StateDatagram(1, 1, 0, np.zeros(3), bad).pack(), 3) is None
    assert wire.command(wire.CommandDatagram(1, False, bad).pack(), 3) is None
    assert wire.state(wire.StateDatagram(1, 1, 7, np.zeros(3), np.zeros(3)).pack(), 3) is None
