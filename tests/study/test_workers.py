"""A worker that dies costs its own task, and no worker outlives its parent."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from workcell.errors import InputError
from workcell.study.workers import LocalWorkers, WorkerDied, death, pool


@pytest.fixture(scope="module")
def workers() -> Iterator[LocalWorkers]:
    with contextlib.closing(_Closing(LocalWorkers(2))) as both:
        yield both.workers


class _Closing:
    def __init__(self, workers: LocalWorkers):
        self.workers = workers

    def close(self) -> None:
        self.workers.shutdown(cancel_futures=True)


def test_a_death_costs_one_task_and_the_others_go_on(workers: LocalWorkers):
    futures = [workers.submit(abs, -k) for k in range(4)]
    futures.insert(2, workers.submit(os._exit, 3))
    with pytest.raises(WorkerDied) as died:
        futures.pop(2).result(timeout=60)
    assert death(died.value) is not None
    assert [future.result(timeout=60) for future in futures] == [0, 1, 2, 3]
    # The dead one has been replaced: two tasks more than one worker could hold still run.
    assert workers.submit(abs, -9).result(timeout=60) == 9


def test_an_exception_of_a_task_is_its_own(workers: LocalWorkers):
    with pytest.raises(ValueError, match="invalid literal") as error:
        workers.submit(int, "one").result(timeout=60)
    assert death(error.value) is None
    assert workers.submit(int, "1").result(timeout=60) == 1


def test_cancelling_ends_workers_in_the_middle_of_what_they_do():
    workers = LocalWorkers(1)
    long, waiting = workers.submit(time.sleep, 600.0), workers.submit(abs, -1)
    while not workers.pids:
        time.sleep(0.05)
    started = time.monotonic()
    workers.shutdown(cancel_futures=True)
    assert time.monotonic() - started < 30.0
    assert long.done()
    assert waiting.cancelled()
    for pid in workers.pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_workers_end_with_a_parent_that_is_killed():
    code = (
        "import sys, time\n"
        "from workcell.study.workers import LocalWorkers\n"
        "if __name__ == '__main__':\n"
        "    workers = LocalWorkers(1)\n"
        "    workers.submit(abs, -1).result()\n"
        "    print(*workers.pids, flush=True)\n"
        "    workers.submit(time.sleep, 600.0)\n"
        "    time.sleep(600)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        parent.send_signal(signal.SIGKILL)
    until = time.monotonic() + 30.0
    while _lives(child) and time.monotonic() < until:
        time.sleep(0.05)
    assert not _lives(child)


def _lives(pid: int) -> bool:
    """Whether a process exists and is no zombie that only its new parent has not yet collected."""
    found = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True)
    return bool(found.stdout.strip()) and not found.stdout.strip().startswith("Z")


@pytest.mark.parametrize(
    ("count", "address", "message"),
    [
        (0, None, "--workers 0: allowed is 1 or more"),
        (2, "tcp://127.0.0.1:1", "a cluster brings its own workers"),
    ],
)
def test_what_cannot_be_had_is_refused(count: int | None, address: str | None, message: str):
    with pytest.raises(InputError, match=message), pool(count, address):
        pass
