"""Jobs run by their own clock, end when they should, and a retreat goes back the way that was come."""

from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from workcell import scenario
from workcell.motion.jobs import (
    APPROACH_M,
    APPROACH_SIDES,
    REPLAN_M,
    REPLAN_S,
    HandOver,
    Instrument,
    JobSequence,
    Meeting,
    Surroundings,
)

DT, D_MIN = 0.01, 0.01
START, UPRIGHT = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
OTHER = np.array([0.5, 0.0, 0.0])


def around(distance_m: float = np.inf, other=OTHER) -> Surroundings:
    return Surroundings(
        {"nurse": START, "surgeon": other}, {"nurse": START, "surgeon": other}, {}, distance_m
    )


def sequence(*jobs: scenario.Job, repeat: int = 1) -> JobSequence:
    return JobSequence(
        jobs, arm="nurse", position_m=START, wxyz=UPRIGHT, d_min_m=D_MIN, repeat=repeat
    )


def move(*points) -> scenario.Move:
    return scenario.Move(kind="move", waypoints=[{"position_m": p} for p in points])


def follow(
    jobs: JobSequence, factor=lambda k: 1.0, ticks: int = 3000
) -> list[tuple[str, np.ndarray]]:
    """An arm that is always at its target; names and targets tick by tick."""
    seen = []
    for k in range(ticks):
        here = jobs.target().position_m
        gap = float(np.linalg.norm(OTHER - here)) - 0.02
        jobs.advance(
            DT,
            factor(k),
            Surroundings(
                {"nurse": here, "surgeon": OTHER}, {"nurse": START, "surgeon": OTHER}, {}, gap
            ),
        )
        seen.append((jobs.name, jobs.target().position_m.copy()))
        if jobs.done:
            break
    return seen


def order(seen) -> list[str]:
    return [name for name, _ in groupby(name for name, _ in seen)]


def test_what_lies_ahead_runs_from_the_present_clock_to_the_goal():
    jobs = sequence(move((0.3, 0.0, 0.0)))
    assert jobs.ahead().shape == (0, 3)
    for _ in range(60):
        jobs.advance(DT, 1.0, around())
    ahead = jobs.ahead(7)
    assert ahead.shape == (7, 3)
    assert ahead[0] == pytest.approx(jobs.target().position_m)
    assert 0.0 < ahead[0, 0] < 0.3
    assert ahead[-1] == pytest.approx([0.3, 0.0, 0.0])
    assert (np.diff(ahead[:, 0]) >= 0.0).all()


def test_jobs_come_in_order_and_end_at_rest():
    jobs = sequence(
        move((0.1, 0.2, 0.0), (0.2, 0.0, 0.0)),
        scenario.Meet(kind="meet", arm="surgeon", dwell_s=0.3),
        scenario.Wait(kind="wait", duration_s=0.2),
        scenario.Retreat(kind="retreat"),
    )
    seen = follow(jobs)
    assert order(seen) == ["move", "meet", "dwell", "wait", "retreat", "done"]
    assert not jobs.target().velocity_m_s.any()
    spent = {name: DT * sum(n == name for n, _ in seen) for name in ("dwell", "wait")}
    assert spent == {
        "dwell": pytest.approx(0.3, abs=2 * DT),
        "wait": pytest.approx(0.2, abs=2 * DT),
    }


def test_a_meeting_stops_at_the_smallest_distance():
    seen = follow(sequence(scenario.Meet(kind="meet", arm="surgeon")))
    (stopped,) = {tuple(p) for name, p in seen if name == "dwell"}
    assert np.linalg.norm(OTHER - stopped) - 0.02 == pytest.approx(D_MIN, abs=0.15 * 2 * DT)


def test_a_retreat_goes_back_along_the_way_that_was_come():
    seen = follow(
        sequence(
            move((0.1, 0.2, 0.0), (0.2, 0.0, 0.0)),
            scenario.Meet(kind="meet", arm="surgeon"),
            scenario.Retreat(kind="retreat"),
        )
    )
    out = np.array([p for name, p in seen if name in ("move", "meet")])
    back = np.array([p for name, p in seen if name == "retreat"])
    apart = [np.linalg.norm(out - p, axis=1).min() for p in back]
    assert max(apart) < 2e-3
    np.testing.assert_allclose(back[-1], START, atol=1e-6)


def test_the_clock_takes_the_factor_and_the_path_stays():
    quick = follow(sequence(move((0.3, 0.0, 0.1))))
    slow = follow(sequence(move((0.3, 0.0, 0.1))), factor=lambda k: 0.5)
    assert len(slow) == pytest.approx(2 * len(quick), abs=4)
    line = np.array([p for _, p in quick])
    for _, p in slow:
        assert np.linalg.norm(line - p, axis=1).min() < 0.15 * DT


def test_a_factor_of_zero_stands_and_loses_nothing():
    jobs = sequence(move((0.3, 0.0, 0.0)))
    held = follow(jobs, factor=lambda k: 0.0 if 50 <= k < 150 else 1.0)
    free = follow(sequence(move((0.3, 0.0, 0.0))))
    assert len(held) == len(free) + 100
    assert len({tuple(p) for _, p in held[51:149]}) == 1


def test_waiting_is_not_slowed():
    seen = follow(sequence(scenario.Wait(kind="wait", duration_s=0.5)), factor=lambda k: 0.0)
    assert len(seen) * DT == pytest.approx(0.5, abs=3 * DT)


def test_repeated_jobs_start_again():
    jobs = sequence(move((0.2, 0.0, 0.0)), scenario.Retreat(kind="retreat"), repeat=2)
    assert order(follow(jobs)) == ["move", "retreat", "move", "retreat", "done"]


def test_a_retreat_with_nothing_travelled_is_over_at_once():
    assert len(follow(sequence(scenario.Retreat(kind="retreat")))) <= 3


# ---------------------------------------------------------------- instruments and entries

TICK_S = 0.02
DOWN = np.array([0.0, 0.0, -1.0])
BASE = np.array([0.5, -1.0, 0.0])
"""Of the surgeon, whose tool is then out along y: its left is -x."""
SIDES = {"left": (-1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0), "above": (0.0, 0.0, 1.0)}
ON_TRAY = np.array([0.1, -0.4, 0.05])


def rod(centre_m, axis_m, holder=None, place_m=ON_TRAY) -> Instrument:
    return Instrument(np.array(centre_m, float), np.array(axis_m, float), place_m, holder)


def present(entry: scenario.Entry = "left", **more) -> scenario.Present:
    return scenario.Present(kind="present", arm="surgeon", entry=entry, distance_m=0.1, **more)


class Cell:
    """An arm that is always at its target and carries what it holds; the surgeon stands where it is put.

    What it meets is met when the tool is within a centimetre of where the job wants it: distances
    are not the jobs' business.
    """

    def __init__(self, *jobs: scenario.Job, instruments: dict[str, Instrument] | None = None):
        self.jobs = sequence(*jobs)
        self.surgeon = OTHER
        self.instruments = instruments or {}
        self.handed: list[tuple[str, HandOver]] = []
        self.meets_at: np.ndarray | None = None
        self.log: list[tuple[str, np.ndarray, np.ndarray]] = []

    def around(self) -> Surroundings:
        here = self.jobs.target().position_m
        gap = np.inf if self.meets_at is None else float(np.linalg.norm(self.meets_at - here))
        return Surroundings(
            {"nurse": here, "surgeon": self.surgeon},
            {"nurse": START, "surgeon": BASE},
            self.instruments,
            gap,
        )

    def tick(self, factor: float = 1.0) -> None:
        before = self.jobs.target()
        name = self.jobs.name
        self.jobs.advance(TICK_S, factor, self.around())
        now = self.jobs.target()
        turn = Rotation.from_quat(now.wxyz, scalar_first=True) * (
            Rotation.from_quat(before.wxyz, scalar_first=True).inv()
        )
        for key, item in self.instruments.items():
            if item.holder == "nurse":
                arm = turn.apply(item.centre_m - before.position_m)
                self.instruments[key] = item._replace(
                    centre_m=now.position_m + arm, axis_m=turn.apply(item.axis_m)
                )
        if self.jobs.hand_over is not None:
            self.handed.append((name, self.jobs.hand_over))
            key = self.jobs.hand_over.instrument
            self.instruments[key] = self.instruments[key]._replace(holder=self.jobs.hand_over.to)
        self.log.append((self.jobs.name, now.position_m.copy(), now.wxyz.copy()))

    def until(self, done, ticks: int = 3000) -> Cell:
        for _ in range(ticks):
            if done():
                return self
            self.tick()
        raise AssertionError(f"still at {self.jobs.name} after {ticks * TICK_S} s")

    def pointing(self) -> np.ndarray:
        wxyz = self.jobs.target().wxyz
        return Rotation.from_quat(wxyz, scalar_first=True).apply([0.0, 0.0, 1.0])


@pytest.mark.parametrize("entry", APPROACH_SIDES)
def test_an_entry_is_a_side_seen_from_the_other_arms_base(entry):
    """It ends `distance_m` before the tool on that side, pointing at it, after a straight last stretch."""
    cell = Cell(present(entry))
    cell.until(lambda: cell.jobs.done)
    side = np.array(SIDES[entry])
    end = cell.log[-1][1]
    np.testing.assert_allclose(end, OTHER + 0.1 * side, atol=1e-3)
    np.testing.assert_allclose(cell.pointing(), -side, atol=1e-6)
    last = [p - OTHER for name, p, _ in cell.log if name == "present"][-20:]
    for p in last:
        assert np.linalg.norm(np.cross(p, side)) < 1e-3, "straight in"


def test_a_tool_right_above_its_base_still_has_a_left_and_a_right():
    goals = []
    for entry in ("left", "right"):
        cell = Cell(present(entry))
        cell.surgeon = BASE + np.array([0.0, 0.0, 0.6])
        cell.until(lambda cell=cell: cell.jobs.done)
        goals.append(cell.log[-1][1] - cell.surgeon)
    np.testing.assert_allclose(goals[0], -goals[1], atol=1e-3)
    assert np.linalg.norm(goals[0]) == pytest.approx(0.1, abs=1e-3)


def test_what_is_held_is_presented_with_its_free_end_first():
    held = rod((0.0, 0.0, 0.09), (0.0, 0.0, 0.07), "nurse")
    cell = Cell(present("left"), instruments={"probe": held})
    cell.until(lambda: cell.jobs.done)
    item, side = cell.instruments["probe"], np.array(SIDES["left"])
    tip = item.centre_m - 0.07 * side
    np.testing.assert_allclose(tip, OTHER + 0.1 * side, atol=2e-3)


def test_an_instrument_is_fetched_from_above_and_held_from_the_end_of_the_dwell():
    lying = rod(ON_TRAY, (0.07, 0.0, 0.0))
    cell = Cell(
        scenario.Fetch(kind="fetch", instrument="probe", dwell_s=0.2), instruments={"probe": lying}
    )
    cell.meets_at = ON_TRAY
    cell.until(lambda: cell.jobs.name == "dwell")
    np.testing.assert_allclose(cell.pointing(), DOWN, atol=1e-3)
    came = np.array([p for name, p, _ in cell.log if name == "fetch"])
    near = came[np.linalg.norm(came - ON_TRAY, axis=1) < 0.9 * APPROACH_M]
    assert len(near) > 5
    np.testing.assert_allclose(near[:, :2] - ON_TRAY[:2], 0.0, atol=2e-3)
    assert not cell.handed, "not before the dwell is over"
    assert cell.jobs.meeting == Meeting(None, "probe")
    cell.until(lambda: cell.jobs.done)
    assert cell.handed == [("dwell", HandOver("probe", "nurse"))]


def test_one_that_stands_is_fetched_at_its_upper_end():
    standing = rod(ON_TRAY, (0.0, 0.0, 0.07))
    cell = Cell(scenario.Fetch(kind="fetch", instrument="probe"), instruments={"probe": standing})
    cell.meets_at = ON_TRAY + np.array([0.0, 0.0, 0.07])
    cell.until(lambda: cell.jobs.done)
    assert cell.handed == [("dwell", HandOver("probe", "nurse"))]


@pytest.mark.parametrize("direction", ["give", "take"])
def test_an_exchange_goes_to_where_the_free_end_is_and_the_holder_changes(direction):
    gives = direction == "give"
    item = (
        rod((0.0, 0.1, 0.0), (0.0, 0.07, 0.0), "nurse")
        if gives
        else rod(OTHER - (0.1, 0.0, 0.0), (0.07, 0.0, 0.0), "surgeon")
    )
    cell = Cell(
        scenario.Exchange(
            kind="exchange", arm="surgeon", instrument="probe", direction=direction, dwell_s=0.1
        ),
        scenario.Retreat(kind="retreat"),
        instruments={"probe": item},
    )
    # Giving brings the free end to the other tool; taking brings this tool to the free end.
    cell.meets_at = OTHER - (0.0, 0.17, 0.0) if gives else OTHER + np.array([-0.17, 0.0, 0.0])
    cell.until(lambda: cell.jobs.name == "exchange")
    assert cell.jobs.meeting == Meeting("surgeon", "probe", gives=gives)
    cell.until(lambda: bool(cell.handed))
    assert cell.handed == [("dwell", HandOver("probe", "surgeon" if gives else "nurse"))]
    assert cell.jobs.name == "retreat"
    assert cell.jobs.meeting is not None, "the pair stays a meeting until the two have parted"
    cell.until(lambda: cell.jobs.done)
    assert len(cell.handed) == 1
    np.testing.assert_allclose(cell.log[-1][1], START, atol=1e-6)


def test_an_instrument_is_put_back_where_it_lay_free_end_down():
    held = rod((0.09, 0.0, 0.0), (0.07, 0.0, 0.0), "nurse")
    cell = Cell(scenario.Put(kind="put", instrument="probe"), instruments={"probe": held})
    cell.until(lambda: cell.jobs.done)
    item = cell.instruments["probe"]
    np.testing.assert_allclose(item.centre_m, ON_TRAY, atol=2e-3)
    np.testing.assert_allclose(np.abs(item.axis_m), (0.0, 0.0, 0.07), atol=1e-6)
    assert cell.log[-1][1][2] > ON_TRAY[2], "the hand is above"
    assert cell.handed == [("put", HandOver("probe", None))]


# ---------------------------------------------------------------- on the way


def test_a_partner_who_moves_is_followed_on_a_new_path_and_tremor_is_not():
    cell = Cell(present("left"))
    plans = 0
    for k in range(3000):
        if cell.jobs.done:
            break
        cell.surgeon = OTHER + 0.4 * REPLAN_M * np.array([0.0, np.sin(0.5 * k), 0.0])
        cell.tick()
        plans += cell.jobs.switched
    assert plans == 2, "one at the start, and one switch to the end"

    cell, moved = Cell(present("left")), np.array([0.0, 0.0, 0.2])
    cell.until(lambda: len(cell.log) * TICK_S > 2 * REPLAN_S)
    cell.surgeon = OTHER + moved
    cell.until(lambda: cell.jobs.done)
    np.testing.assert_allclose(
        cell.log[-1][1], OTHER + moved + 0.1 * np.array(SIDES["left"]), atol=1e-3
    )


def test_new_paths_come_no_more_often_than_they_can_be_got_under_way():
    cell, switched = Cell(present("left")), []
    for k in range(200):
        cell.surgeon = OTHER + 0.1 * k * TICK_S * np.array([0.0, 1.0, 0.0])
        cell.tick()
        switched += [k] * cell.jobs.switched
    assert len(switched) > 3
    assert min(np.diff(switched)) * TICK_S >= REPLAN_S - TICK_S


def test_the_side_can_change_on_the_way_without_a_leap():
    cell = Cell(present("left"))
    cell.until(lambda: len(cell.log) * TICK_S > 2.0)
    before = cell.jobs.target()
    assert cell.jobs.enter_from("right", cell.around())
    assert cell.jobs.switched
    np.testing.assert_allclose(cell.jobs.target().position_m, before.position_m, atol=1e-9)
    assert not cell.jobs.target().velocity_m_s.any(), "from rest"
    cell.until(lambda: cell.jobs.done)
    np.testing.assert_allclose(cell.log[-1][1], OTHER + 0.1 * np.array(SIDES["right"]), atol=1e-3)


def test_a_retreat_goes_back_the_way_that_was_come_whatever_was_replanned():
    cell = Cell(present("left"), scenario.Retreat(kind="retreat"))
    cell.until(lambda: len(cell.log) * TICK_S > 2.0)
    cell.jobs.enter_from("above", cell.around())
    cell.until(lambda: cell.jobs.done)
    out = np.array([p for name, p, _ in cell.log if name == "present"])
    back = np.array([p for name, p, _ in cell.log if name == "retreat"])
    assert max(np.linalg.norm(out - p, axis=1).min() for p in back) < 2e-3
    np.testing.assert_allclose(back[-1], START, atol=1e-6)


def test_other_entries_are_tried_in_turn_and_only_while_presenting():
    cell = Cell(present("right"), scenario.Wait(kind="wait", duration_s=1.0))
    assert not cell.jobs.try_another_entry(cell.around()), "nothing is being presented yet"
    cell.tick()
    assert cell.jobs.try_another_entry(cell.around())
    cell.until(lambda: cell.jobs.name == "wait")
    np.testing.assert_allclose(cell.log[-1][1], OTHER + 0.1 * np.array(SIDES["above"]), atol=1e-3)
    assert not cell.jobs.enter_from("left", cell.around())


def test_each_entry_is_tried_once_and_the_one_asked_for_is_kept_then():
    cell = Cell(present("right"), scenario.Retreat(kind="retreat"), present("left"))
    cell.tick()
    tried = []
    while cell.jobs.try_another_entry(cell.around()):
        tried.append(cell.jobs._side)
    assert tried == ["above", "left", "right"]
    cell.until(lambda: cell.jobs.finished == 2)
    cell.tick()
    assert cell.jobs.try_another_entry(cell.around()), "another presentation, another round"


def test_the_rotation_is_free_only_where_the_job_says_so():
    cell = Cell(present("left", free_rotation=True), scenario.Wait(kind="wait", duration_s=1.0))
    assert not cell.jobs.free_rotation
    cell.tick()
    assert cell.jobs.free_rotation
    cell.until(lambda: cell.jobs.name == "wait")
    assert not cell.jobs.free_rotation


def test_a_side_once_asked_for_holds_for_the_presentation_on_its_way_and_all_after():
    cell = Cell(present("left"), scenario.Retreat(kind="retreat"), present("above"))
    cell.tick()
    cell.jobs.prefer("right", cell.around())
    assert cell.jobs.switched
    cell.tick()
    cell.jobs.prefer("right", cell.around())
    assert not cell.jobs.switched, "asked for again, nothing changes"
    for presented in (1, 3):
        cell.until(lambda presented=presented: cell.jobs.finished == presented)
        np.testing.assert_allclose(
            cell.log[-1][1], OTHER + 0.1 * np.array(SIDES["right"]), atol=1e-3
        )
