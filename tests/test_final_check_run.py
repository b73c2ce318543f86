"""The final check in whole runs: it stops what the controller does not, and runs end well without it.

The controller is the real one, in a real run; what is wrong with it is `sabotage.factor_multiplier`,
which undoes its scaling. The judge of contacts is not the check of the run.
"""

from __future__ import annotations

import json
import os
import re
import signal
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell import assets, cli, loop
from workcell import run as runner
from workcell.control.controller import Controller
from workcell.errors import InputError
from workcell.guard.check_setup import check_settings
from workcell.judge import ContactWatch, JudgedScene
from workcell.trace.table import load

VELOCITY_RAD_S, ACCELERATION_RAD_S2 = [0.5, 0.5, 0.75], [0.8, 0.8, 1.2]
"""So weak that an arm which first brakes when the capsules touch, 45 mm before the housings, may run into them."""
CHECK_D_MIN_M = 0.12
"""Stopping takes 0.63 s at most: 78 mm from 0.25 m/s, after 15 mm until the check is heard; the rest is for
parts of the arm that are faster than its tool."""
SHORT = ("simulation.duration_s=0.96",)
"""120 ticks."""
LINKS_M = (0.35, 0.35, 0.2)


def elbow_and_tip(base_m: float, home_rad: np.ndarray) -> np.ndarray:
    """(3, 2) the ends of planar3's links in its plane."""
    angle = np.cumsum(home_rad)
    steps = np.array(LINKS_M)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.array([base_m, 0.0]) + np.cumsum(steps, axis=0)


def along(base_m: float, home_rad: np.ndarray) -> np.ndarray:
    """(30, 2) points on the links."""
    ends = np.vstack([[base_m, 0.0], elbow_and_tip(base_m, home_rad)])
    share = np.linspace(0.1, 1.0, 10)[:, None]
    return np.vstack([a + share * (b - a) for a, b in pairwise(ends)])


def approach(rng: np.random.Generator) -> dict:
    """The nurse goes straight for a point inside the surgeon's arm, and nothing slows it down."""
    content = cells.duet(d_min_m=0.002)
    surgeon, nurse = content["arm"]
    while True:
        surgeon_rad = np.array([2.2, 0.9, -0.6]) + rng.uniform(-0.3, 0.3, 3)
        nurse_rad = np.array([1.9, -0.9, -0.6]) + rng.uniform(-0.3, 0.3, 3)
        ends = elbow_and_tip(0.4, surgeon_rad)
        target = ends[1] + rng.uniform(0.0, 1.0) * (ends[2] - ends[1])
        # The tool keeps its orientation: its wrist must reach, with room to spare.
        direction = np.sum(nurse_rad)
        wrist = target - LINKS_M[2] * np.array([np.cos(direction), np.sin(direction)])
        reaches = 0.25 < np.linalg.norm(wrist - [-0.4, 0.0]) < 0.55
        # The nurse must start beyond the distance at which the check halts, beams included.
        gap = along(0.4, surgeon_rad)[:, None] - along(-0.4, nurse_rad)
        if reaches and np.linalg.norm(gap, axis=-1).min() > CHECK_D_MIN_M + 0.06:
            break
    surgeon |= {"home_rad": surgeon_rad.tolist(), "base_position_m": [0.4, 0.0, 0.0]}
    nurse |= {"home_rad": nurse_rad.tolist(), "base_position_m": [-0.4, 0.0, 0.0]}
    nurse |= {
        "velocity_limit_rad_s": VELOCITY_RAD_S,
        "acceleration_limit_rad_s2": ACCELERATION_RAD_S2,
    }
    nurse["job"] = [
        {
            "kind": "move",
            "waypoints": [{"position_m": [*target.tolist(), 0.3]}],
            "speed_m_s": float(rng.uniform(0.18, 0.25)),
            "acceleration_m_s2": 1.0,
        }
    ]
    content["simulation"] |= {"period_s": 0.01, "duration_s": 4.0}
    content["check"] = {"d_min_m": CHECK_D_MIN_M}
    content["control"]["gate"] = False  # it would see through the sabotage
    content["sabotage"] = {"factor_multiplier": 1e6}
    return content


def end_of_approach(folder: Path, content: dict) -> tuple[ContactWatch, runner.Ending] | None:
    """One run until the nurse stands or touches; None if the draw cannot be run."""
    try:
        cell = runner.prepare(cells.load(folder, content), folder / "run" / runner.SCENE_FOLDER)
    except InputError:
        return None
    settings = cell.scenario.model_dump(mode="json")
    of_arms = {arm.name: arm.dofs.tolist() for arm in cell.arms}
    judge = ContactWatch(JudgedScene(cell.model, settings, of_arms), clear_m=CHECK_D_MIN_M)
    dofs = next(arm.dofs for arm in cell.arms if arm.name == "nurse")

    def watch(tick: int, data: mujoco.MjData, controller: Controller) -> bool:
        judge.look(tick * cell.period_s, data.qpos, data.qvel)
        stands = tick > 0 and not controller.record.command_rad_s[dofs].any()
        return judge.contact is not None or (stands and controller.record.check_state == "halt")

    return judge, runner.simulate(cell, folder / "run", watch=watch)


def count_stops(folder: Path, *, wanted: int) -> list[float]:
    """Smallest distance of each of so many approaches that the check has stopped; none may touch."""
    rng, smallest_m = np.random.default_rng(2008), []
    for draw in range(20 * wanted):
        if len(smallest_m) == wanted:
            return smallest_m
        ended = end_of_approach(folder / str(draw), approach(rng))
        if ended is None:
            continue
        judge, ending = ended
        assert judge.contact is None, (draw, judge.contact)
        assert ending.check is not None
        halt = ending.check["halt"]
        if halt is not None and halt["tick"] > 0:
            assert halt["state"] == "halt", halt
            assert set(halt["stopping_time_s"]) == {"nurse"}, "the priority arm is never frozen"
            smallest_m.append(judge.smallest_m)
    raise AssertionError(f"only {len(smallest_m)} of {wanted} approaches came near")


def test_eight_sabotaged_approaches_are_stopped_without_contact(tmp_path):
    smallest_m = count_stops(tmp_path, wanted=8)
    # The stop is needed: they came nearer than the check allows, by what braking takes.
    assert 0.0 < min(smallest_m) < CHECK_D_MIN_M


@pytest.mark.long
def test_two_hundred_sabotaged_approaches_are_stopped_without_contact(tmp_path):
    assert min(count_stops(tmp_path, wanted=200)) > 0.0


FAULTS = {
    "lost": lambda pid: os.kill(pid, signal.SIGKILL),
    "stopped": lambda pid: os.kill(pid, signal.SIGSTOP),
}


@pytest.mark.parametrize("state", FAULTS)
def test_a_checker_that_goes_in_a_run_stops_the_arms(tmp_path, monkeypatch, state):
    """Killed or suspended at tick 60: the nurse brakes and stands, and the run says why."""
    pids = []
    real = loop.LatchedCheck

    class Tampered(real):
        def ask(self, tick, *rest):
            if tick == 60:
                pids.append(self._check.pid)
                FAULTS[state](pids[0])
            return super().ask(tick, *rest)

    monkeypatch.setattr(loop, "LatchedCheck", Tampered)
    monkeypatch.setattr(
        loop,
        "check_settings",
        lambda cell: replace(check_settings(cell), lockstep_deadline_s=0.5),
    )
    content = cells.duet()
    summary = runner.run(cells.load(tmp_path, content, *SHORT), tmp_path / "run")
    assert summary["held"] is False
    assert summary["metrics"]["stopped_by_check"] == state
    halt = summary["final_check"]["halt"]
    assert halt["state"] == state
    assert halt["tick"] == 60
    assert halt["stopping_time_s"]["nurse"] is not None
    trace = load(tmp_path / "run")
    assert len(trace) == 120
    assert trace["check_state"][59] == "clear"
    assert trace["check_state"][60] == state
    assert (trace["nurse.mode"][60:] == "halt").all()
    nurse = [k for k, name in enumerate(trace.layout.joints) if name.startswith("nurse/")]
    assert np.abs(trace["command_rad_s"][59, nurse]).max() > 0.01, "it was moving"
    assert not trace["command_rad_s"][-1, nurse].any()
    with pytest.raises(ProcessLookupError):
        os.kill(pids[0], 0)


def test_a_stop_that_the_scenario_expects_is_no_failure(tmp_path):
    content = approach(np.random.default_rng(5))
    content["check"] = {"d_min_m": 0.4}
    folders = tmp_path / "unexpected", tmp_path / "expected"
    with pytest.raises(InputError, match="stops the arms at their start"):
        runner.run(cells.load(folders[0], content, *SHORT), folders[0] / "run")
    content["expect"] = {"stopped_by_check": "halt"}
    expected = runner.run(cells.load(folders[1], content, *SHORT), folders[1] / "run")
    assert expected["held"] is True
    assert json.loads((folders[1] / "run" / "summary.json").read_text())["final_check"]["halt"]


@pytest.mark.parametrize(("stops", "modes"), [(False, {"hold", "run"}), (True, {"halt"})])
def test_priority_arms_are_stopped_only_if_the_scenario_says_so(tmp_path, stops, modes):
    content = cells.duet()
    content["check"] = {"d_min_m": 0.4, "stops_priority_arms": stops}
    content["expect"] = {"stopped_by_check": "halt"}
    runner.run(cells.load(tmp_path, content, "simulation.duration_s=0.2"), tmp_path / "run")
    trace = load(tmp_path / "run")
    assert (trace["nurse.mode"] == "halt").all()
    assert set(trace["surgeon.mode"]) <= modes


def test_workcell_check_refuses_what_the_final_check_could_not_judge(tmp_path, capsys):
    """No process is started for it: an arm whose tool, which is to be exempt, has capsules only."""
    text = assets.model_file("planar3").read_text(encoding="utf-8")
    (tmp_path / "bare.xml").write_text(re.sub(r'<geom class="housing" name="link[23].*', "", text))
    content = cells.duet()
    content["arm"][1]["model"] = "bare.xml"
    path = cells.write(tmp_path, content)
    assert cli.main(["check", str(path)]) == 2
    said = capsys.readouterr().err
    assert f"{path}: check.enabled = true: exemptions.nurse_surgeon.geoms_i" in said
    assert "'nurse/link3'" in said
    content["arm"][1]["job"] = [{"kind": "wait", "duration_s": 1.0}]
    assert cli.main(["check", str(cells.write(tmp_path, content))]) == 2
    assert "no geometry for nurse/link2, nurse/link3" in capsys.readouterr().err
    assert cli.main(["check", str(path), "--set", "check.enabled=false"]) == 0
