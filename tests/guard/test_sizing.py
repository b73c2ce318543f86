"""The sizing rule of the final check's d_min: its inverse, and what is said of a scenario that does not keep it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import cells
from workcell.cli import main
from workcell.guard.sizing import largest_closing_m_s, late_stops, needed_m


@given(st.floats(1e-4, 0.5), st.floats(0.01, 20.0), st.floats(1e-3, 0.5))
def test_the_largest_closing_speed_is_the_inverse_of_the_rule(d_min_m, a, look_s):
    speed = largest_closing_m_s(d_min_m, a, look_s)
    assert speed > 0.0
    assert needed_m(speed, a, look_s) == pytest.approx(d_min_m, rel=1e-6)


def test_a_ticked_stop_from_the_largest_speed_ends_before_contact():
    d_min_m, a, dt, every = 0.02, 1.5, 0.01, 5
    v = largest_closing_m_s(d_min_m, a, (every + 1) * dt)
    way = v * (every + 1) * dt  # just missed by one look, seen by the next
    while v > 0.0:
        v = max(0.0, v - a * dt)
        way += v * dt
    assert 0.9 * d_min_m < way <= d_min_m


def test_a_scenario_says_which_stop_is_late(tmp_path, capsys):
    content = cells.duet()
    content["check"] = {"d_min_m": 0.5}
    roomy = cells.build(tmp_path / "roomy", content)
    assert not [note for note in late_stops(roomy) if "along its path" in note]
    content["check"] = {"d_min_m": 0.0005}
    (note,) = late_stops(cells.build(tmp_path / "tight", content))
    assert "d_min 0.5 mm: a stop of nurse that closes faster than" in note
    assert "along its path asks for" in note
    content["check"] = {"enabled": False}
    assert not list(late_stops(cells.build(tmp_path / "off", content)))
    content["check"] = {"d_min_m": 0.0005}
    assert main(["check", str(cells.write(tmp_path / "told", content))]) == 0
    assert "ends after contact" in capsys.readouterr().out.replace("\n", " ")
