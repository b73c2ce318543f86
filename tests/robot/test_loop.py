"""The robot loop with robots of Python: the commands are the run's, and whatever is wrong stops all robots, by name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests import cells
from workcell import InputError
from workcell import run as runner
from workcell.robot import loop as module
from workcell.robot.adapter import Reading
from workcell.robot.loop import RobotLoop
from workcell.trace.table import load

PERIOD_S, TICKS = 0.008, 60
PATIENT_S = 5.0
"""Age of a reading that a busy machine is forgiven; what is stale is tested by itself."""


class Perfect:
    """A robot that does what it is told, at once."""

    def __init__(self, home):
        self.position, self.velocity = np.array(home, dtype=float), np.zeros(len(home))
        self.number, self.stops, self.closed = -1, [], False

    def read(self) -> Reading | None:
        told = "told to" if self.stops else ""
        return Reading(self.position.copy(), self.velocity.copy(), self.number, told)

    def write(self, number, velocity) -> None:
        self.number, self.velocity = number, np.array(velocity)
        self.position = self.position + self.velocity * PERIOD_S

    def stop(self, reason) -> None:
        self.stops.append(reason)
        self.velocity = np.zeros(len(self.position))

    def close(self) -> None:
        self.closed = True


class Odd(Perfect):
    """One whose readings are changed from a command on."""

    def __init__(self, home, change, *, since: int = 20):
        super().__init__(home)
        self._change, self._since = change, since

    def read(self) -> Reading | None:
        reading = super().read()
        return self._change(reading) if self.number >= self._since and not self.stops else reading


def scenario(folder: Path, *overrides: str):
    content = cells.duet(t_min_s=0.5)
    # Moving from the start, so that there is something to stop.
    return cells.load(
        folder,
        content,
        f"simulation.duration_s={TICKS * PERIOD_S}",
        "check.enabled=false",
        *overrides,
    )


def homes(what) -> dict[str, tuple[float, ...]]:
    return {arm.name: arm.home_rad for arm in what.arm}


def drive(folder: Path, *, surgeon=Perfect, nurse=Perfect, stale_s=PATIENT_S):
    what = scenario(folder)
    robots = {
        name: make(homes(what)[name]) for name, make in (("surgeon", surgeon), ("nurse", nurse))
    }
    loop = RobotLoop(what, robots, folder / "run", stale_s=stale_s)
    return loop.run(), robots


def test_robots_are_commanded_what_a_run_commands(tmp_path):
    summary, robots = drive(tmp_path)
    what = scenario(tmp_path, "simulation.plant=kinematic")
    runner.run(what, tmp_path / "simulated")
    real, simulated = load(tmp_path / "run"), load(tmp_path / "simulated")
    assert len(real) == TICKS
    for column in ("qpos", "command_rad_s", "plant_qpos", "pair_distance_m", "nurse.scale"):
        np.testing.assert_array_equal(real[column], simulated[column], err_msg=column)
    assert np.abs(real["command_rad_s"]).max() > 0.05
    assert summary["metrics"]["fault"] is None
    assert summary["robots"]["ticks"] == TICKS
    assert summary["robots"]["stood"] is True
    for robot in robots.values():
        assert set(robot.stops) == {"the run is over"}
        assert robot.closed


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda r: replace(r, stopped="protective stop"),
            "robot surgeon stands by itself: protective stop",
        ),
        (lambda r: replace(r, position_rad=r.position_rad * np.nan), "what is not finite"),
        (lambda r: replace(r, velocity_rad_s=r.velocity_rad_s + np.inf), "what is not finite"),
    ],
)
def test_a_robot_that_is_not_well_stops_all(tmp_path, change, words):
    summary, robots = drive(tmp_path, surgeon=lambda home: Odd(home, change))
    assert words in summary["metrics"]["fault"]
    assert summary["held"] is False
    assert summary["robots"]["ticks"] == 21
    assert len(load(tmp_path / "run")) == 20
    assert all(words in robot.stops[0] for robot in robots.values())
    assert all(robot.closed for robot in robots.values())


@pytest.mark.parametrize("kind", ["silent", "repeating"])
def test_a_robot_that_is_not_heard_of_stops_all(tmp_path, kind):
    kept = {}

    def change(reading):
        # Either nothing comes any more, or the same old state comes again and again.
        return None if kind == "silent" else kept.setdefault("first", reading)

    summary, robots = drive(tmp_path, surgeon=lambda home: Odd(home, change), stale_s=0.2)
    assert "robot surgeon was last heard of" in summary["metrics"]["fault"]
    assert "allowed is 0.2 s" in summary["metrics"]["fault"]
    assert 20 < len(load(tmp_path / "run")) < TICKS
    assert robots["nurse"].stops


def test_where_a_robot_is_not_where_its_arm_starts_nothing_moves(tmp_path):
    what = scenario(tmp_path)
    robots = {name: Perfect(home) for name, home in homes(what).items()}
    robots["nurse"].position[1] += 0.05
    with pytest.raises(
        InputError, match=r"robot nurse: nurse/J2 is at -0.8500, home_rad has -0.9000"
    ):
        RobotLoop(what, robots, tmp_path / "run").run()
    robots["nurse"] = Perfect((0.0, 0.0))
    with pytest.raises(InputError, match="tells of 2 joints; its arm has 3"):
        RobotLoop(what, robots, tmp_path / "run").run()
    assert all(robot.number == -1 for robot in robots.values()), "nothing was commanded"


def test_a_robot_that_never_answers_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "START_S", 0.05)
    what = scenario(tmp_path)
    robots = {name: Perfect(home) for name, home in homes(what).items()}
    robots["surgeon"].read = lambda: None
    with pytest.raises(InputError, match=r"robot surgeon: has not answered within 0\.05 s"):
        RobotLoop(what, robots, tmp_path / "run").run()


def test_what_cannot_be_driven_is_refused(tmp_path):
    what = scenario(tmp_path)
    with pytest.raises(
        InputError, match="robots are given for nurse; needed is one for each of surgeon, nurse"
    ):
        RobotLoop(what, {"nurse": Perfect((0, 0, 0))}, tmp_path / "run")
    with pytest.raises(InputError, match="stale_s"):
        RobotLoop(
            what, {n: Perfect(h) for n, h in homes(what).items()}, tmp_path / "run", stale_s=0
        )
    from workcell import load_scenario

    giving = load_scenario("give_instrument")
    with pytest.raises(InputError, match="nobody measures where instruments are"):
        RobotLoop(giving, {n: Perfect(()) for n in homes(giving)}, tmp_path / "run")
