"""The pace of a live run: held back to the clock, told when it is not, and the period that can be held."""

from __future__ import annotations

import pytest

from tests import cells
from workcell.errors import InputError
from workcell.live import pace as pace_module
from workcell.live.pace import GIVE_UP_S, Pace, choose_period, speed_words
from workcell.live.teleop import LONGEST_S, _open_ended, teleop


class Clock:
    """A clock that only sleeping and working move."""

    def __init__(self):
        self.now_s = 100.0
        self.slept_s = 0.0

    def __call__(self):
        return self.now_s

    def sleep(self, time_s):
        self.now_s += time_s
        self.slept_s += time_s


def pace(work_s):
    """Ticks of 10 ms, each followed by work."""
    clock = Clock()
    keeper = Pace(0.01, clock=clock, sleep=clock.sleep)
    for tick, busy_s in enumerate(work_s):
        keeper.wait(tick)
        clock.now_s += busy_s
    return keeper.account, clock


def test_a_fast_run_is_held_back_to_the_clock():
    account, clock = pace([0.004] * 100)
    assert clock.now_s - 100.0 == pytest.approx(99 * 0.01 + 0.004)
    assert (account.ticks, account.missed, account.slipped_s) == (100, 0, 0.0)


def test_one_long_tick_is_counted_and_caught_up_with():
    account, clock = pace([0.004] * 10 + [0.055] + [0.004] * 89)
    assert 1 <= account.missed < 10
    assert account.worst_late_s == pytest.approx(0.045)
    assert account.slipped_s == 0.0
    assert clock.now_s - 100.0 == pytest.approx(99 * 0.01 + 0.004)


def test_a_run_too_slow_for_the_clock_slips_instead_of_racing():
    account, clock = pace([0.02] * 100)
    assert clock.slept_s == 0.0
    assert account.missed > 80
    assert account.worst_late_s < GIVE_UP_S + 0.02
    assert account.slipped_s == pytest.approx(1.0, abs=0.12)


def test_the_speed_that_is_told_is_that_of_the_last_seconds():
    clock = Clock()
    keeper = Pace(0.01, clock=clock, sleep=clock.sleep)
    assert keeper.speed == 1.0
    for tick in range(400):
        keeper.wait(tick)
        clock.now_s += 0.004
    assert keeper.speed == pytest.approx(1.0, abs=0.01)
    for tick in range(400, 800):
        keeper.wait(tick)
        clock.now_s += 0.02
    assert keeper.speed == pytest.approx(0.5, abs=0.02)
    assert speed_words(keeper.speed).startswith("half speed")
    assert speed_words(1.0) == "real time"
    assert speed_words(0.25) == "25 % speed"


def test_a_pause_is_not_lateness():
    clock = Clock()
    keeper = Pace(0.01, clock=clock, sleep=clock.sleep)
    for tick in range(10):
        keeper.wait(tick)
    clock.now_s += 60.0
    keeper.resume()
    for tick in range(10, 20):
        keeper.wait(tick)
    assert keeper.account.missed == 0
    assert keeper.account.slipped_s == 0.0
    assert keeper.speed == 1.0


def live_duet(tmp_path, **simulation):
    content = cells.duet()
    content["check"] = {"enabled": False}
    content["simulation"] |= simulation
    content["arm"][0]["operator"] = {"kind": "live"}
    return cells.load(tmp_path, content)


@pytest.mark.parametrize(
    ("needs_s", "period_s", "words"),
    [
        (0.0005, 0.002, "in real time"),
        (0.003, 0.005, "instead of 2 ms"),
        (0.5, 0.02, "slower than the clock"),
    ],
)
def test_the_smallest_period_that_holds_is_chosen_and_said(
    tmp_path, monkeypatch, needs_s, period_s, words
):
    monkeypatch.setattr(pace_module, "tick_s", lambda scenario: needs_s)
    choice = choose_period(live_duet(tmp_path, period_s=0.002))
    assert choice.scenario.simulation.period_s == period_s
    assert words in choice.said


def test_a_period_that_was_asked_for_is_kept_and_said_not_to_hold(tmp_path, monkeypatch):
    monkeypatch.setattr(pace_module, "tick_s", lambda scenario: 0.5)
    choice = choose_period(live_duet(tmp_path, period_s=0.004), keep=True)
    assert choice.scenario.simulation.period_s == 0.004
    assert "as asked" in choice.said


def test_a_tick_is_measured_by_running_it(tmp_path):
    assert 0.0 < pace_module.tick_s(live_duet(tmp_path)) < 1.0


def test_tele_operation_needs_a_live_arm(tmp_path):
    from workcell import scenario

    with pytest.raises(InputError, match="no arm has an operator of kind 'live'"):
        teleop(scenario.load("handover"), tmp_path)


def test_a_session_is_not_ended_by_the_scripts_duration(tmp_path):
    own = live_duet(tmp_path)
    assert _open_ended(own).simulation.duration_s == LONGEST_S
    assert _open_ended(own).simulation.period_s == own.simulation.period_s
