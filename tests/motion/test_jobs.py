"""Jobs run by their own clock, end when they should, and a retreat goes back the way that was come."""

from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest

from workcell import scenario
from workcell.motion.jobs import JobSequence, Surroundings

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
