"""A task that asks for less than a pose: the tool is where it should be, and what is not asked for is free."""

from __future__ import annotations

import numpy as np
import pytest

from tests import cells
from tests.scene.test_normal_form import leg
from workcell import run
from workcell.admission import admit
from workcell.errors import InputError
from workcell.trace.table import load as load_trace

WAY = [{"position_m": [0.1, 0.1, 0.75]}, {"position_m": [0.2, -0.1, 0.6]}]


def pa10(asked: str, **job) -> dict:
    """One PA10 that goes along two waypoints."""
    return {
        "name": "one",
        "simulation": {"plant": "kinematic", "duration_s": 8.0, "period_s": 0.004},
        "check": {"enabled": False},
        "arm": [
            {
                "name": "nurse",
                "model": "pa10",
                "base_position_m": [-0.4, 0.0, 0.0],
                "home_rad": [1.045, -0.227, 0.323, 1.693, -1.480, 1.368, 1.476],
                "task": asked,
                "job": [{"kind": "move", "waypoints": WAY, **job}],
            }
        ],
    }


@pytest.mark.parametrize("task", ["axis", "position"])
def test_the_tool_is_on_its_path_and_turns_as_it_likes(tmp_path, task):
    content = pa10(task)
    content["simulation"]["duration_s"] = 4.0
    path = tmp_path / "run"
    run.run(cells.load(tmp_path, content), path)
    trace = load_trace(path)
    error_m = np.array(trace["nurse.tool_error_m"])
    error_rad = np.array(trace["nurse.tool_error_rad"])
    wxyz = np.array(trace["nurse.tool_wxyz"])
    assert error_m.max() < 2e-4
    assert error_rad.max() < 2e-3
    turned = 2 * np.arccos(np.clip(np.abs(wxyz @ wxyz[0]), 0, 1)).max()
    assert turned > 0.05, "what is not asked for is free"


def test_a_job_may_ask_for_something_else_than_its_arm(tmp_path):
    content = pa10("position", task="pose")
    content["simulation"]["duration_s"] = 3.0
    run.run(cells.load(tmp_path, content), tmp_path / "run")
    wxyz = np.array(load_trace(tmp_path / "run")["nurse.tool_wxyz"])
    assert np.abs(wxyz @ wxyz[0]).min() > 1 - 1e-5


def test_an_arm_of_two_joints_is_told_what_it_can_be_asked(tmp_path):
    content = pa10("pose")
    content["arm"][0] |= {"model": str(leg(tmp_path)), "home_rad": [0.3, 0.4]}
    with pytest.raises(InputError) as refused:
        admit(cells.load(tmp_path, content), tmp_path / "scene")
    words = "the task has six directions, the arm two joints"
    assert words in str(refused.value)
    assert "arm.nurse.task = 'axis' has five, 'position' has three" in str(refused.value)
