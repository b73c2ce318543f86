"""The gate in the loop: nothing that steers a support arm gets past it, and what it does is told."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.control.controller import Controller
from workcell.control.passage import _Flight
from workcell.control.steering import Strategies
from workcell.errors import InputError
from workcell.judge import judge_trace
from workcell.regression.compare import compare
from workcell.regression.excerpt import excerpt
from workcell.scene import cell as scene
from workcell.trace.table import load

SECONDS = ("simulation.duration_s=6", "check.enabled=false")

SABOTAGE = {
    "times three": lambda rng, last, x: 3.0 * x,
    "reversed": lambda rng, last, x: -x,
    "random": lambda rng, last, x: rng.uniform(-1.5, 1.5, len(x)),
    "frozen": lambda rng, last, x: last if np.abs(last).max() > 0.25 else x,
}


def sabotage(monkeypatch, kind: str) -> None:
    """Spoil every answer of the nurse's strategy."""
    steer, rng = Strategies.steer, np.random.default_rng(7)

    def spoiled(self, arm, view):
        answer = steer(self, arm, view)
        if not arm.support:
            return answer
        velocity = SABOTAGE[kind](rng, view.command_rad_s, answer.velocity_rad_s)
        return answer._replace(velocity_rad_s=velocity)

    monkeypatch.setattr(Strategies, "steer", spoiled)


@pytest.mark.parametrize("kind", SABOTAGE)
def test_a_sabotaged_strategy_touches_nothing(tmp_path, monkeypatch, kind):
    sabotage(monkeypatch, kind)
    scenario = cells.load(tmp_path, cells.duet(), *SECONDS)
    cell = runner.prepare(scenario, tmp_path / runner.SCENE_FOLDER)
    ending = runner.simulate(cell, tmp_path)
    assert ending.fault is None
    trace = load(tmp_path)
    verdict = judge_trace(trace, cell.model)
    assert verdict.contacts_by_support == 0
    assert verdict.capsules_m is not None
    assert verdict.capsules_m > 0.0
    metrics = runner.summarise(cell, trace, ending)["metrics"]
    if kind in ("times three", "random"):  # the others lead nowhere near anything
        assert metrics["gated_ticks"] == metrics["nurse.gated_ticks"] > 10
    assert metrics["surgeon.gated_ticks"] == 0


def test_the_row_says_what_was_gated_why_and_for_which_pair(tmp_path, monkeypatch):
    sabotage(monkeypatch, "times three")
    cell = cells.build(tmp_path, cells.duet(), *SECONDS)
    runner.simulate(cell, tmp_path)
    trace = load(tmp_path)
    told = trace["nurse.gate"].astype(str)
    assert {t.split(":")[0] for t in told if t} <= {"nearest", "towards_braking", "braking"}
    of_pairs = np.char.find(told, "time_to_collision") >= 0
    assert of_pairs.any()
    assert (trace["nurse.gate_pair"][of_pairs] >= 0).all()
    assert (trace["nurse.gate_pair"][told == ""] == -1).all()
    assert (trace["surgeon.gate"] == "").all()
    # A run agrees with itself in it, nulls and all.
    assert compare(excerpt(trace), excerpt(trace)).kind == "same"


def test_an_honest_arm_is_not_gated(tmp_path):
    cell = cells.build(tmp_path, cells.duet(), *SECONDS)
    runner.simulate(cell, tmp_path)
    assert (load(tmp_path)["nurse.gate"] == "").all()


def test_without_the_final_check_the_gate_stays(tmp_path):
    with pytest.raises(
        InputError, match=r"control\.gate = false: allowed only with check\.enabled"
    ):
        cells.load(tmp_path, cells.duet(gate=False), "check.enabled=false")


def test_a_run_without_the_gate_says_so(tmp_path):
    cell = cells.build(tmp_path, cells.duet(gate=False))
    assert any("UNVERIFIED" in note for note in cell.notes)


def test_no_point_is_faster_than_the_cap(tmp_path):
    """At 0.05 m/s the nurse, which would move at 0.15, is held by the gate alone."""
    cell = cells.build(tmp_path, cells.duet(point_speed_m_s=0.05), *SECONDS)
    runner.simulate(cell, tmp_path)
    trace = load(tmp_path)
    assert set(trace["nurse.gate"].astype(str)) == {"", "nearest: point_speed"}
    peak = judge_trace(trace, cell.model, cap_m_s=0.05).arms["nurse"].motion.peak_point_speed_m_s
    assert peak == pytest.approx(0.05, rel=1e-2)


# ---------------------------------------------------------------- what is ahead of the joints


def flown(tmp_path, behind: int, ticks: int = 60):
    """Way ahead of the nurse's joints at each tick (one end of its interval is 0), and how far they really have to go: servos that many ticks behind."""
    cell = cells.build(tmp_path, cells.duet())
    arm = next(a for a in Controller(cell)._arms if a.name == "nurse")
    flight, q, last = _Flight(cell, arm), [arm.addresses.home_rad], np.zeros(3)
    for k in range(ticks):
        low, high = flight.ahead(q[max(0, k - behind)], last)
        yield low + high, q[k] - q[max(0, k - behind)]
        last = np.array([0.3, -0.2, 0.1]) * np.sin(0.2 * k)
        q.append(q[k] + cell.period_s * last)


@pytest.mark.parametrize("behind", [0, 1, 7])
def test_what_a_servo_has_not_followed_yet_is_ahead(tmp_path, behind):
    for way, really in flown(tmp_path, behind):
        np.testing.assert_allclose(way, really, atol=1e-12)


def test_a_joint_that_sags_while_it_stands_has_nothing_ahead(tmp_path):
    cell = cells.build(tmp_path, cells.duet())
    arm = next(a for a in Controller(cell)._arms if a.name == "nurse")
    flight, home = _Flight(cell, arm), arm.addresses.home_rad
    flight.ahead(home, np.zeros(3))
    np.testing.assert_array_equal(flight.ahead(home - 0.01, np.zeros(3)), 0.0)


def test_a_held_instrument_is_gated_as_a_part_of_the_hand(tmp_path):
    """The rows of a pair with the instrument that the nurse holds move with the nurse's joints."""
    loaded = scenario_file.load("entry_left")
    cell = scene.build(loaded, tmp_path / "scene")
    holder = next(item.held_by for item in loaded.instrument if item.held_by == "nurse")
    controller = Controller(cell)
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    controller.step(data.qpos.copy(), np.zeros(cell.model.nv))
    gate = controller._passage._gates[holder]._gate
    rows, watched = gate._rows, controller._sensing.watched
    arm = next(a for a in controller._arms if a.name == holder)
    np.testing.assert_allclose(rows.own, watched.jacobian[np.ix_(rows.pair, arm.dofs)], atol=1e-9)
    item = cell.instruments[0].geom
    held = [k for k, pair in enumerate(rows.pair) if item in cell.pairs.geoms[pair]]
    assert held
    assert np.abs(rows.own[held]).max() > 0.1
