"""Every way in which the check can fail is a named state that stops, and nothing is left over."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from workcell.errors import InputError
from workcell.guard import CheckState, FinalCheck, Verdict
from workcell.guard.settings import TestFault
from workcell.guard.verdict import CheckState as State

from .cell import CLEAR_POSE, CRASH_POSE, settings, write_scene

# Faults begin with the third request, so that each test sees the check work first.
FROM = 3
# A fault must be named within the deadline; this much more is granted to a busy machine, s.
GRACE_S = 1.0


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("scene"))


def is_stopped(pid: int) -> bool:
    status = Path(f"/proc/{pid}/stat")
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] == "T"


def is_gone(pid: int) -> bool:
    """True if no process of that id runs (one that ended but is not reaped does not run)."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    status = Path(f"/proc/{pid}/stat")
    try:
        return status.read_text().rpartition(")")[2].split()[0] in "ZX"
    except FileNotFoundError:
        return True


def wait_until(condition: Callable[[], bool], limit_s: float) -> bool:
    until_s = time.monotonic() + limit_s
    while time.monotonic() < until_s:
        if condition():
            return True
        time.sleep(0.01)
    return condition()


def started(scene: Path, **changes: object) -> FinalCheck:
    check = FinalCheck(scene, settings(lockstep_deadline_s=0.4, **changes))
    assert check.start().state == CheckState.CLEAR
    return check


FAULTS = [
    ("slow", State.LATE),
    ("old_sequence", State.STALE),
    ("future_sequence", State.NONSENSE),
    ("not_a_number", State.NONSENSE),
    ("garbage", State.NONSENSE),
    ("kill_self", State.LOST),
    ("stop_self", State.STOPPED),
]


@pytest.mark.parametrize(("kind", "state"), FAULTS)
def test_in_lock_step_each_fault_has_its_name_within_the_deadline(scene, kind, state):
    with started(scene, test_fault=TestFault(kind, FROM, seconds=3.0)) as check:
        pid = check.pid
        assert check.check(0, CLEAR_POSE).state == CheckState.CLEAR
        assert check.check(1, CLEAR_POSE).state == CheckState.CLEAR
        began_s = time.monotonic()
        verdict = check.check(2, CLEAR_POSE)
        took_s = time.monotonic() - began_s
    assert verdict.state == state, verdict
    assert verdict.must_stop
    assert verdict.reason
    assert verdict.distance_m is None
    assert verdict.pair is None
    assert took_s < 0.4 + GRACE_S
    assert pid is not None
    assert is_gone(pid)


# An answer is judged alike in both ways of running; what is waited for differs.
@pytest.mark.parametrize(
    ("kind", "state"), [fault for fault in FAULTS if fault[1] != State.NONSENSE]
)
def test_in_free_run_each_fault_stops_within_the_deadline(scene, kind, state):
    fault = TestFault(kind, FROM, seconds=3.0)
    with started(scene, deadline_s=0.2, max_age_ticks=10_000, test_fault=fault) as check:
        verdict: Verdict | None = None
        good_s = time.monotonic()
        for tick in range(2000):
            assert check.post(tick, CLEAR_POSE) is None
            verdict = check.poll(tick)
            if verdict.must_stop:
                break
            if verdict.sequence < FROM - 1:
                good_s = time.monotonic()
            time.sleep(0.002)
        took_s = time.monotonic() - good_s
    assert verdict is not None
    assert verdict.state == state, verdict
    assert took_s < 0.2 + GRACE_S


@pytest.mark.parametrize(
    ("kill", "state"), [(signal.SIGKILL, State.LOST), (signal.SIGSTOP, State.STOPPED)]
)
def test_a_checker_that_goes_between_checks_is_noticed_without_asking(scene, kill, state):
    with started(scene) as check:
        assert check.check(0, CLEAR_POSE).state == CheckState.CLEAR
        assert check.pid is not None
        os.kill(check.pid, kill)
        assert wait_until(lambda: check.poll(0).state == state, GRACE_S), check.poll(0)


def test_a_late_checker_is_not_waited_for_again_but_may_come_back(scene):
    with started(scene) as check:
        pid = check.pid
        assert pid is not None
        check.check(0, CLEAR_POSE)
        os.kill(pid, signal.SIGSTOP)
        assert check.check(1, CLEAR_POSE).state == CheckState.STOPPED
        began_s = time.monotonic()
        assert all(check.check(2 + k, CLEAR_POSE).must_stop for k in range(20))
        assert time.monotonic() - began_s < 0.3
        os.kill(pid, signal.SIGCONT)
        # Whether to go on is the latch's business; the check only tells how things are.
        assert wait_until(lambda: not check.check(50, CLEAR_POSE).must_stop, GRACE_S)


@pytest.mark.parametrize(
    ("fault", "deadline_s", "reason"),
    [
        (TestFault("crash_at_start"), 30.0, "exit status 1.*RuntimeError: crash_at_start"),
        (TestFault("hang_at_start", seconds=30.0), 0.3, "not ready within 0.3 s"),
    ],
)
def test_a_checker_that_does_not_start_is_named(scene, fault, deadline_s, reason):
    with FinalCheck(scene, settings(test_fault=fault, start_deadline_s=deadline_s)) as check:
        verdict = check.start()
        assert verdict.state == CheckState.FAILED_TO_START
        assert re.search("(?s)" + reason, verdict.reason), verdict.reason
        assert check.pid is None
        for later in (check.check(0, CLEAR_POSE), check.poll(0), check.post(0, CLEAR_POSE)):
            assert later is not None
            assert later.state == CheckState.FAILED_TO_START


def test_asking_before_start_or_after_the_end_stops(scene):
    check = FinalCheck(scene, settings())
    assert check.check(0, CLEAR_POSE).state == CheckState.FAILED_TO_START
    check.start()
    check.close()
    check.close()
    assert check.check(0, CLEAR_POSE).reason == "the check has been closed"


def test_a_broken_scene_is_refused_by_name_and_leaves_no_process(tmp_path: Path):
    path = write_scene(tmp_path, "<mujoco><worldbody><geom size='0'/></worldbody></mujoco>")
    check = FinalCheck(path, settings())
    with pytest.raises(InputError, match=r"scene\.xml: the scene does not compile"):
        check.start()
    assert check.pid is None
    assert check.check(0, CLEAR_POSE).state == CheckState.FAILED_TO_START


PARENT = """
import sys, time
sys.path[:0] = [{root!r}, {tests!r}]
from pathlib import Path
from guard.cell import CLEAR_POSE, settings
from workcell.guard import FinalCheck
check = FinalCheck(Path({scene!r}), settings())
check.start()
print(check.pid, check.check(0, CLEAR_POSE).state, flush=True)
{then}
"""


@pytest.mark.parametrize(
    ("then", "stop_child"),
    [
        pytest.param("time.sleep(60)", False, id="killed"),
        pytest.param("time.sleep(60)", True, id="killed while the checker is suspended"),
        pytest.param("raise SystemExit(0)", False, id="ended without closing"),
    ],
)
def test_when_the_parent_dies_nothing_is_left(scene, then: str, stop_child: bool):
    tests = Path(__file__).parents[1]
    shared = Path("/dev/shm")
    before = set(os.listdir(shared)) if shared.is_dir() else set()
    text = PARENT.format(root=str(tests.parent), tests=str(tests), scene=str(scene), then=then)
    # No guard on __main__ and no file: the checker must not need to import its parent's program.
    parent = subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid_text, state = parent.stdout.readline().split()
    pid = int(pid_text)
    assert state == "clear"
    try:
        if stop_child:
            os.kill(pid, signal.SIGSTOP)
            # On a busy machine it takes a while to stop; one that stops after its parent has gone stays.
            assert wait_until(lambda: is_stopped(pid), 3.0)
        if "sleep" in then:
            assert not is_gone(pid)
            parent.kill()
        parent.wait(10)
        assert wait_until(lambda: is_gone(pid), 3.0), "the checker outlived its parent"
        if shared.is_dir():
            assert not [name for name in set(os.listdir(shared)) - before if "workcell" in name]
    finally:
        parent.stdout.close()
        parent.kill()
        if not is_gone(pid):
            os.kill(pid, signal.SIGKILL)


def test_descriptors_are_given_back(scene):
    listing = Path("/proc/self/fd")
    if not listing.is_dir():
        pytest.skip("this system does not list descriptors")
    before = len(list(listing.iterdir()))
    for _ in range(3):
        with started(scene) as check:
            check.check(0, CRASH_POSE)
    assert len(list(listing.iterdir())) == before
