"""An arm that repeats the joint motion of a recorded run does so to the last bit, whatever the others do."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell.errors import InputError
from workcell.trace.table import load

PERSON = {
    "kind": "human",
    "sites": [{"position_m": [-0.1, 0.40, 0.3]}, {"position_m": [-0.1, 0.45, 0.3]}],
    "pause_s": [0.05, 0.1],
    "start_s": 0.1,
    "withdraw_m": [0.0, -0.05, 0.0],
}


def content(plant="kinematic", **simulation):
    made = cells.duet()
    made["simulation"] |= {"plant": plant, "duration_s": 1.0, "period_s": 0.01} | simulation
    made["check"] = {"enabled": False}
    made["arm"][0]["operator"] = copy.deepcopy(PERSON)
    return made


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    runner.run(cells.load(folder, content()), folder / "run")
    return folder / "run"


def again(recorded, folder, made, *overrides):
    loaded = cells.load(folder, made, f"arm.surgeon.operator.run={recorded}", *overrides)
    runner.run(loaded, folder / "again")
    return load(folder / "again")


def surgeon(trace, name):
    return np.asarray(trace[name])[:, trace.metadata["dofs"]["surgeon"]]


def test_the_joints_move_as_recorded_to_the_last_bit_though_the_other_arm_does_not(
    recorded, tmp_path
):
    first = load(recorded)
    second = again(recorded, tmp_path, content(), "arm.nurse.job.0.speed_m_s=0.02")
    assert np.abs(surgeon(first, "command_rad_s")).max() > 0.05
    assert np.array_equal(surgeon(first, "command_rad_s"), surgeon(second, "command_rad_s"))
    assert np.array_equal(surgeon(first, "plant_qpos"), surgeon(second, "plant_qpos"))
    assert not np.array_equal(
        np.asarray(first["nurse.tool_position_m"]), np.asarray(second["nurse.tool_position_m"])
    )
    assert np.array_equal(
        np.asarray(first["surgeon.target_position_m"]),
        np.asarray(second["surgeon.target_position_m"]),
    )
    assert set(second["surgeon.job"]) == {"joints"}


def test_at_another_period_the_joints_pass_through_the_recorded_positions(recorded, tmp_path):
    second = again(recorded, tmp_path, content(period_s=0.004))
    then = surgeon(load(recorded), "plant_qpos")[::2]  # every 0.02 s
    now = surgeon(second, "plant_qpos")[::5]
    assert now[: len(then)] == pytest.approx(then[: len(now)], abs=1e-9)


def test_after_the_recorded_run_the_arm_stands(recorded, tmp_path):
    second = again(recorded, tmp_path, content(duration_s=1.3))
    assert list(second["surgeon.operator_state"][[0, 99, 100, 129]]) == [
        "valid",
        "valid",
        "ended",
        "ended",
    ]
    assert not surgeon(second, "command_rad_s")[100:].any()


def refused(recorded, folder, *overrides):
    loaded = cells.load(folder, content(), f"arm.surgeon.operator.run={recorded}", *overrides)
    with pytest.raises(InputError) as error:
        runner.prepare(loaded, folder / "scene")
    return str(error.value)


def test_what_cannot_be_repeated_is_refused_before_the_run(recorded, tmp_path):
    assert "no arm 'helper'; allowed for arm: surgeon, nurse" in refused(
        recorded, tmp_path, "arm.surgeon.operator.arm=helper"
    )
    home = list(content()["arm"][0]["home_rad"])
    home[1] += 0.1
    assert "the arm must start where the recorded one did" in refused(
        recorded, tmp_path, f"arm.surgeon.home_rad={home}"
    )
    assert "run = " in refused(tmp_path / "nothing", tmp_path)
