"""What `check` passes can be run, and what is refused leaves no folder and no earlier run changed."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests import cells
from workcell import cli
from workcell import run as runner
from workcell.admission import admit
from workcell.errors import InputError

SHORT = "simulation.duration_s=0.08"


def refusal(folder, content, *overrides: str) -> str:
    with pytest.raises(InputError) as refused:
        admit(cells.load(folder, content, *overrides), folder / "scene")
    return str(refused.value)


def test_a_meeting_out_of_reach_is_refused_before_the_run(tmp_path):
    told = refusal(tmp_path, cells.duet(), "arm.nurse.base_position_m=[-4.0, 0.0, 0.0]")
    assert "arm.nurse.job.0 (meet): the tool of surgeon at (" in told
    assert "is out of reach: the tool stays" in told


def test_a_meeting_that_no_run_of_this_length_begins_is_not_judged(tmp_path):
    content = cells.duet()
    content["arm"][1]["job"].insert(0, {"kind": "wait", "duration_s": 2.0})
    away = "arm.nurse.base_position_m=[-4.0, 0.0, 0.0]"
    assert "arm.nurse.job.1 (meet)" in refusal(tmp_path, content, away, "simulation.duration_s=9.0")
    admit(cells.load(tmp_path, content, away, "simulation.duration_s=1.9"), tmp_path / "short")


def test_an_instrument_out_of_reach_is_refused_before_the_run(tmp_path):
    content = cells.duet()
    content["instrument"] = [{"name": "scalpel", "position_m": [3.0, 3.0, 0.5]}]
    content["arm"][1]["job"] = [{"kind": "fetch", "instrument": "scalpel"}]
    told = refusal(tmp_path, content)
    assert "arm.nurse.job.0 (fetch): instrument scalpel at (3.000, 3.000, 0.500) m" in told
    assert "out of reach" in told


def test_a_hand_that_comes_into_reach_while_it_works_is_not_refused(tmp_path):
    content = cells.duet()
    content["arm"][1]["base_position_m"] = [-1.3, 0.0, 0.0]
    assert "arm.nurse.job.0 (meet)" in refusal(tmp_path, content)
    near = {"position_m": [-0.8, 0.3, 0.3]}
    content["arm"][0]["operator"] = {"kind": "waypoints", "waypoints": [near]}
    # Whether the surgeon itself reaches that place is another question.
    assert not any("arm.nurse" in fault for fault in _reach_faults(tmp_path, content))


def test_a_free_rotation_is_free_in_the_reach_test_too(tmp_path):
    content = cells.duet()
    loaded = cells.build(tmp_path, content)
    data = mujoco.MjData(loaded.model)
    loaded.place_home(data)
    mujoco.mj_kinematics(loaded.model, data)
    site = loaded.arms[1].tool_site
    turned = np.empty(4)
    about_the_tool = np.array([np.cos(0.4), 0.0, 0.0, np.sin(0.4)])
    home = np.empty(4)
    mujoco.mju_mat2Quat(home, data.site_xmat[site])
    mujoco.mju_mulQuat(turned, home, about_the_tool)
    here = {"position_m": data.site_xpos[site].tolist(), "wxyz": turned.tolist()}
    content["arm"][1]["job"] = [{"kind": "move", "waypoints": [here], "free_rotation": True}]
    assert _reach_faults(tmp_path, content) == []
    content["arm"][1]["job"][0]["free_rotation"] = False
    assert "rad away" in _reach_faults(tmp_path, content)[0]


def _reach_faults(folder, content) -> list[str]:
    try:
        admit(cells.load(folder, content), folder / "scene")
    except InputError as error:
        return [fault for fault in error.faults if "out of reach" in fault]
    return []


def test_the_first_look_of_the_final_check_is_taken_before_the_run(tmp_path):
    told = refusal(tmp_path, cells.duet(), "check.d_min_m=0.45")
    assert "check.enabled = true: stops the arms at their start" in told
    assert "d_min_m = 0.45" in told
    admit(
        cells.load(tmp_path, cells.duet(), "check.d_min_m=0.45", "check.enabled=false"),
        tmp_path / "off",
    )


def test_an_arm_that_touches_itself_at_the_start_is_told_how_to_say_that_it_may(tmp_path):
    content = cells.duet()
    content["arm"][1]["home_rad"] = [0.5, 2.6, 2.6]  # the probe is back at the first link
    told = refusal(tmp_path, content)
    assert "stops the arms at their start: nurse/link1" in told
    assert (
        'if they touch by construction, say so in the arm file: <contact><exclude body1="link1" body2="link3"/>'
        in told
    )
    assert "[[ignore]]" in told


def test_a_recording_is_opened_and_judged(tmp_path):
    told = refusal(tmp_path, cells.duet(), "arm.surgeon.operator.file=none.csv")
    assert "arm.surgeon.operator.file" in told
    assert "no such recording" in told
    (tmp_path / "epoch.csv").write_text(
        "time_s,x_m,y_m,z_m,qw,qx,qy,qz\n1.79e9,0,0,0,1,0,0,0\n1.79e9,0,0,0,1,0,0,0\n"
    )
    told = refusal(tmp_path, cells.duet(), f"arm.surgeon.operator.file={tmp_path / 'epoch.csv'}")
    assert "row" in told


def test_a_refused_run_makes_no_folder_and_leaves_an_earlier_one(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = str(cells.write(tmp_path, cells.duet()))
    bad = ("--set", "expect.complete=true")
    assert cli.main(["run", path, "--out", "out", *bad]) == 2
    assert not (tmp_path / "out").exists()
    assert cli.main(["run", path, "--out", "out", "--set", SHORT]) == 0
    before = (tmp_path / "out" / "summary.json").read_bytes()
    assert cli.main(["run", path, "--out", "out", *bad]) == 2
    assert (tmp_path / "out" / "summary.json").read_bytes() == before
    assert "did you mean 'completed'" in capsys.readouterr().err


NUMBERS = st.sampled_from(
    [
        "control.t_min_s",
        "control.d_min_m",
        "control.standoff_m",
        "control.task_gain_per_s",
        "control.rise_time_s",
        "control.reaction_s",
        "control.slow_distance_m",
        "control.criterion_gain",
        "simulation.period_s",
        "simulation.position_noise_rad",
        "arm.nurse.base_position_m.0",
        "arm.nurse.home_rad.1",
        "arm.nurse.job.0.speed_m_s",
        "arm.nurse.job.0.acceleration_m_s2",
        "check.d_min_m",
        "arm.nurse.priority",
    ]
)


@given(
    changes=st.dictionaries(
        NUMBERS,
        st.floats(-3, 3, allow_subnormal=False)
        | st.sampled_from([1e-6, 1e-3, 0.0, 1.0, 50.0, 1e3, 1e6]),
        min_size=1,
        max_size=3,
    )
)
@settings(
    max_examples=15,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_run_never_refuses_what_check_passed(tmp_path, changes):
    overrides = [f"{key}={value!r}" for key, value in changes.items()]
    try:
        loaded = cells.load(tmp_path, cells.duet(), *overrides, "simulation.duration_s=0.04")
        admit(loaded, tmp_path / "scene")
    except InputError:
        return
    summary = runner.run(loaded, tmp_path / "run")
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["held"] == summary["held"]
    assert np.isfinite(summary["metrics"]["duration_s"])
