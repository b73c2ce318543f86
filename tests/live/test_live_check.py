"""The final check beside a live run: a checker that is slow, suspended or killed stops the nurse and stalls nobody."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell.guard.check_setup import check_settings
from workcell.guard.monitor import FinalCheck
from workcell.guard.settings import TestFault
from workcell.guard.supervisor import LatchedCheck
from workcell.live.pace import Pace
from workcell.loop import final_check
from workcell.trace.table import load

FAULT_TICK = 60
TICKS = 190
STALL_S = 1.0
"""Far below the 5 s of lock-step, far above what a busy machine takes from a thread."""


class Person:
    """Keeps the pace of the wall clock, does something to the checker, and measures the ticks."""

    def __init__(self, cell, check: FinalCheck, act):
        self._pace, self._check, self._act = Pace(cell.period_s), check, act
        self._last_s: float | None = None
        self.longest_s = 0.0

    def watch(self, tick, data, controller):
        now_s = time.monotonic()
        if self._last_s is not None:
            self.longest_s = max(self.longest_s, now_s - self._last_s)
        if tick == FAULT_TICK:
            self._act(self._check)
        self._pace.wait(tick)
        self._last_s = time.monotonic()
        return tick >= TICKS


def session(folder: Path, act, fault: TestFault | None = None, deadline_s: float = 0.4):
    """A live run of two planar arms; returns its trace, the check's account and the longest tick."""
    content = cells.duet()
    content["check"] = {"enabled": True}
    cell = runner.prepare(cells.load(folder, content), folder / "run" / "scene")
    scene_xml = folder / "run" / "scene" / "scene.xml"
    # One deadline for every machine: what is tested is that nobody waits, not how fast a core is.
    settings = replace(
        check_settings(cell), deadline_s=deadline_s, max_age_ticks=1000, test_fault=fault
    )
    with FinalCheck(scene_xml, settings) as check:
        assert not check.start().must_stop
        latched = LatchedCheck(check, period_s=cell.period_s, live=True)
        person = Person(cell, check, act)
        runner.simulate(cell, folder / "run", watch=person.watch, check=latched)
        account = latched.account()
    return load(folder / "run"), account, person.longest_s


def nothing(check: FinalCheck) -> None:
    """The person leaves the checker alone."""


@pytest.mark.long  # counts real time, which a second worker on the same cores spoils
@pytest.mark.parametrize(
    ("act", "fault", "state"),
    [
        (nothing, TestFault("slow", FAULT_TICK, seconds=30.0), "late"),
        (lambda check: os.kill(check.pid, signal.SIGSTOP), None, "stopped"),
        (lambda check: os.kill(check.pid, signal.SIGKILL), None, "lost"),
    ],
    ids=["slow", "stopped", "killed"],
)
def test_a_checker_at_fault_stops_the_nurse_and_stalls_nobody(tmp_path, act, fault, state):
    trace, account, longest_s = session(tmp_path, act, fault)
    assert longest_s < STALL_S
    assert len(trace) == TICKS
    assert account["halt"]["state"] == state
    before, after = trace["check_state"][: FAULT_TICK // 2], trace["check_state"][-1]
    assert set(before) == {"clear"}
    assert after == state
    nurse = trace["command_rad_s"][:, 3:]
    assert np.abs(nurse[: FAULT_TICK // 2]).max() > 0.01, "the nurse was on its way"
    assert not nurse[-1].any(), "the nurse stands"
    assert trace["nurse.mode"][-1] == "halt"


def test_a_sound_checker_looks_at_every_tick_and_is_never_waited_for(tmp_path):
    trace, account, longest_s = session(tmp_path, nothing, deadline_s=STALL_S)
    assert longest_s < STALL_S
    assert account["halt"] is None
    assert set(trace["check_state"]) == {"clear"}
    assert account["latency"]["answers"] > TICKS / 2


def test_teleop_and_only_it_asks_without_waiting(tmp_path):
    content = cells.duet()
    content["check"] = {"enabled": True}
    cell = runner.prepare(cells.load(tmp_path, content), tmp_path / "run" / "scene")
    for live in (True, False):
        with final_check(cell, tmp_path / "run", live=live) as check:
            assert check is not None
            assert check.is_live == live
