"""What a row says of a run: commands short of t_min are counted where, and only where, the support arm is at fault."""

from __future__ import annotations

from typing import Any

import pytest

from tests import cells
from workcell import scenario as scenario_file
from workcell.study.outcome import Outcome, perform


def made(**content: Any) -> Outcome:
    what = cells.duet() | {"check": {"enabled": False}} | content
    what["simulation"] = {"plant": "kinematic", "period_s": 0.02, "duration_s": 10.0}
    return perform(0, "", scenario_file.validate(what, None), False).outcome


def test_an_honest_arm_is_never_short_of_t_min():
    row = made()
    assert row.status == "ran"
    assert row.smallest_ttc_command_own_s == pytest.approx(1.0, abs=1e-3)
    assert (row.short_ticks, row.short_reason) == (0, "")


def test_an_arm_that_cheats_is_counted_and_says_in_which_state_it_was():
    row = made(
        sabotage={"factor_multiplier": 1.5}, control={"gate": False}, check={"d_min_m": 1e-3}
    )
    assert row.smallest_ttc_command_own_s is not None
    assert row.smallest_ttc_command_own_s < 0.9
    assert row.short_ticks
    assert row.short_reason.startswith("nurse: ")


def test_a_person_who_comes_near_is_not_the_support_arms_fault():
    """The nurse waits, the surgeon's tool comes to it: nothing of that is counted."""
    content = cells.duet()
    content["arm"][0]["operator"] = {
        "kind": "waypoints",
        "waypoints": [{"position_m": [-0.17, 0.47, 0.3]}],
    }
    content["arm"][1] |= {
        "base_position_m": [-0.25, 0.0, 0.0],
        "job": [{"kind": "wait", "duration_s": 4.0}],
    }
    content["control"] = {"yields": False}
    row = made(**content)
    assert row.smallest_ttc_s is not None
    assert row.smallest_ttc_s < 1.0
    assert row.short_ticks == 0
