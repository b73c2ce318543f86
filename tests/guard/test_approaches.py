"""Check, latch and brake together: an arm that nobody slows down is stopped before contact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from workcell.guard import CheckState, HaltLatch, Verdict, brake
from workcell.guard.checker import Checker
from workcell.guard.judge import judge
from workcell.guard.shared_memory import Request

from .cell import PERIOD_S, random_pose, settings, write_scene

# Rare on purpose: the fewer checks, the more must d_min leave room for.
EVERY_TICKS = 25
ACCELERATION_RAD_S2 = np.full(10, 5.0)
SPEED_RAD_S = 0.3
# The nurse's farthest point is 0.75 m from its axes; five joints at this speed could move it at
# about 0.6 m/s, if all added up. Room for one check interval, the tick that reacts, and braking.
CLOSING_M_S = 0.6
D_MIN_M = CLOSING_M_S * ((EVERY_TICKS + 1) * PERIOD_S + 0.5 * SPEED_RAD_S / 5.0)


@pytest.mark.parametrize("wanted", [40, pytest.param(200, marks=pytest.mark.long)])
def test_unscaled_approaches_end_without_contact(tmp_path: Path, wanted: int):
    given = settings(d_min_m=D_MIN_M, every_ticks=EVERY_TICKS)
    checker = Checker(write_scene(tmp_path), given)
    names = [piece.name for piece in checker.geometry.pieces]
    sequence, stopped, nearest_m = 0, 0, []

    def ask(tick: int, qpos: np.ndarray) -> Verdict:
        nonlocal sequence
        sequence += 1
        answer = checker.answer(Request(sequence, tick, (), qpos))
        return judge(answer, given, pieces=names, missing=(), expired=(), tick=tick)

    rng = np.random.default_rng(2008)
    while stopped < wanted:
        qpos, target = random_pose(rng), random_pose(rng)
        target[5:] = qpos[5:]
        # Unchecked, every one of these ends in contact: the target itself is one.
        if ask(0, qpos).must_stop or (ask(0, target).distance_m or 0.0) >= 0.0:
            continue
        latch = HaltLatch(PERIOD_S)
        command = (target - qpos) / np.max(np.abs(target - qpos)) * SPEED_RAD_S
        tick = 0
        while not latch.trip(ask(tick, qpos), tick):
            qpos = qpos + command * PERIOD_S * EVERY_TICKS
            tick += EVERY_TICKS
        # The verdict comes within the tick; braking begins with the next command.
        qpos = qpos + command * PERIOD_S
        way_m = [checker.answer(Request(sequence, 0, (), qpos)).distance_m]
        while command.any():
            command = brake(command, ACCELERATION_RAD_S2, PERIOD_S)
            qpos = qpos + command * PERIOD_S
            way_m.append(checker.answer(Request(sequence, 0, (), qpos)).distance_m)
        report = latch.report()
        assert report is not None
        assert report.state == CheckState.HALT
        stopped += 1
        nearest_m.append(min(way_m))
        assert min(way_m) > 0.0, (report, qpos)
    # The stop is really needed and really uses the room it was given.
    assert min(nearest_m) < 0.8 * D_MIN_M
