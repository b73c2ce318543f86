"""Past an obstacle with the tool off its path, and arms whose null space is not the controller's."""

from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest

from tests import cells
from tests.control.test_impasse import DT, STANDOFF_M, ideal
from workcell import run as runner
from workcell import scenario
from workcell.control.setpoints import REJOIN_M
from workcell.errors import InputError
from workcell.scene import cell as scene

DETOUR_M = 0.1
GOAL_M = (-0.09, 0.60)


def behind_a_post(folder, post_m=(-0.17, 0.68), **control):
    """The nurse's way leads past a post that stands so near that its tool cannot keep to it."""
    content = cells.duet(standoff_m=STANDOFF_M, **control)
    content["simulation"] |= {"duration_s": 12.0, "period_s": DT}
    content["arm"][0]["base_position_m"] = [1.5, 0.0, 0.0]
    content["arm"][1]["job"] = [{"kind": "move", "waypoints": [{"position_m": [*GOAL_M, 0.3]}]}]
    content["obstacle"] = [
        {
            "name": "post",
            "shape": "capsule",
            "size_m": [0.03, 0.2],
            "position_m": [*post_m, 0.3],
        }
    ]
    return cells.build(folder, content)


def nurse(records):
    return [record.arms["nurse"] for record in records]


def test_a_detour_passes_what_stands_at_the_path_within_what_is_allowed(tmp_path):
    records = list(ideal(behind_a_post(tmp_path, detour_m=DETOUR_M)))
    rows = nurse(records)
    assert [a for a, _ in groupby(row.attempt for row in rows)] == ["", "detour", ""]
    assert rows[-1].job == "done"
    assert rows[-1].tool_error_m < REJOIN_M
    assert REJOIN_M < max(row.tool_error_m for row in rows) < DETOUR_M
    assert min(r.pair_distance_m.min() for r in records) > STANDOFF_M
    off = [row.tool_error_m for row in rows if not row.attempt]
    assert max(off) < 1.1 * REJOIN_M, "off its path on the detour alone"


def test_without_leave_the_same_arm_stays_on_its_path_and_does_not_get_there(tmp_path):
    rows = nurse(ideal(behind_a_post(tmp_path)))
    assert "detour" not in {row.attempt for row in rows}
    assert rows[-1].job == "move"


def test_a_goal_that_cannot_be_reached_is_not_done_from_beside_it(tmp_path):
    """The post stands where the arm itself has to be: the tool gets near, within the leave, and no farther."""
    rows = nurse(ideal(behind_a_post(tmp_path, post_m=(-0.17, 0.64), detour_m=DETOUR_M)))
    assert "detour" in {row.attempt for row in rows}
    assert {row.job for row in rows} == {"start", "move"}


def test_what_a_detour_may_be_is_bounded(tmp_path):
    with pytest.raises(InputError, match="detour_m"):
        cells.build(tmp_path, cells.duet(detour_m=-0.1))


@pytest.mark.long
def test_handover_gets_done_past_an_elbow_that_may_not_move(tmp_path):
    overrides = (
        "simulation.plant=kinematic",
        "simulation.period_s=0.02",
        "simulation.duration_s=40",
        "check.enabled=false",
        "arm.surgeon.self_motion=false",
        "control.standoff_m=0.012",
    )
    for detour_m, done in ((0.0, False), (0.15, True)):
        folder = tmp_path / str(detour_m)
        settings = (*overrides, f"control.detour_m={detour_m}")
        metrics = runner.run(scenario.load("handover", settings), folder)["metrics"]
        assert metrics["completed"] is done
        assert metrics["contact"] is False
        assert metrics["surgeon.elbow_travel_m"] < 1e-3
        assert metrics["smallest_distance_apart_m"] > 0.01


def test_an_arm_without_self_motion_moves_as_little_as_its_tool_needs(tmp_path):
    """PA10s, of which one has a null space and another arm near it: with the criterion it swings, without it stands."""
    moved = {}
    for allowed in (True, False):
        loaded = scenario.load(
            "handover",
            (
                "simulation.plant=kinematic",
                "simulation.period_s=0.02",
                "simulation.duration_s=3",
                f"arm.surgeon.self_motion={str(allowed).lower()}",
            ),
        )
        cell = scene.build(loaded, tmp_path / str(allowed))
        speed = [np.abs(r.command_rad_s[cell.arms[0].dofs]).max() for r in ideal(cell)]
        moved[allowed] = max(speed)
    assert moved[True] > 0.01
    assert moved[False] < 1e-6
