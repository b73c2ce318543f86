"""Where the runs of a study are made: on the cores of this machine, or on a Dask cluster.

Both are `concurrent.futures.Executor`s, so a study does not know which one it has. The local one
gives every worker a pool of its own with a single process: the standard pool, shared, loses what
all its workers are doing when one of them dies, and cannot say whose task killed it.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, cast

from workcell.errors import InputError, WorkcellError
from workcell.extras import need

RUNS_PER_PROCESS = 200
"""After so many runs a worker process is replaced by a fresh one. Chosen so that what a library keeps per
compiled model cannot add up, at a start-up cost (2 s) of 1 % of the shortest runs."""


ANSWER_S = 10.0
"""So long a Dask scheduler may take to answer."""


class WorkerDied(WorkcellError):
    """The process that made a run ended before the run did (killed, out of memory, crashed)."""


class LocalWorkers(Executor):
    """Worker processes on this machine, each making one run at a time.

    Args:
        count: How many.
    """

    def __init__(self, count: int):
        self._tasks: queue.SimpleQueue[tuple[Future, Callable[..., Any], tuple] | None] = (
            queue.SimpleQueue()
        )
        self._pids: dict[int, int] = {}
        self._ending = False
        self._threads = [
            threading.Thread(target=self._serve, args=(k,), daemon=True) for k in range(count)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of the workers that have been started."""
        return tuple(self._pids.values())

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Queue a call; its future raises `WorkerDied` if the process it was given to dies."""
        if kwargs:
            raise TypeError("the calls of a study take positional arguments only")
        future: Future = Future()
        self._tasks.put((future, fn, args))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers; with `cancel_futures` at once, in the middle of what they do."""
        self._ending = True
        if cancel_futures:
            with contextlib.suppress(queue.Empty):
                while True:
                    task = self._tasks.get_nowait()
                    if task is not None:
                        task[0].cancel()
            for pid in self.pids:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGTERM)
        for _ in self._threads:
            self._tasks.put(None)
        if wait:
            for thread in self._threads:
                thread.join()

    def _serve(self, index: int) -> None:
        """Hand tasks to one process, one at a time, and start another when it dies or is used up."""
        pool: ProcessPoolExecutor | None = None
        made = 0
        while (task := self._tasks.get()) is not None:
            future, fn, args = task
            if not future.set_running_or_notify_cancel():
                continue
            try:
                if pool is None:
                    pool, made = _one_process(), 0
                    self._pids[index] = pool.submit(os.getpid).result()
                result = pool.submit(_call, fn, args).result()
            except BrokenProcessPool as error:
                future.set_exception(WorkerDied(f"worker {index} died: {error}"))
                pool = None
            except (Exception, KeyboardInterrupt) as error:
                # Handed on, to be raised where the result is asked for.
                future.set_exception(error)
            else:
                future.set_result(result)
            made += 1
            if pool is not None and made >= RUNS_PER_PROCESS:
                pool.shutdown()
                pool = None
                del self._pids[index]
        if pool is not None:
            pool.shutdown()


@contextlib.contextmanager
def pool(count: int | None, address: str | None) -> Iterator[tuple[Executor, int]]:
    """Who makes the runs, and how many at a time; ended on leaving, finished or not.

    Args:
        count: Local processes, None for one a core of those this process may use.
        address: Of a Dask scheduler, whose workers are then taken instead.

    Raises:
        InputError: no workers asked for, both kinds asked for, or no such cluster.
    """
    if address is not None:
        if count is not None:
            raise InputError("--workers and --cluster: a cluster brings its own workers; drop one")
        with _cluster(address) as found:
            yield found
        return
    if count is not None and count < 1:
        raise InputError(f"--workers {count}: allowed is 1 or more")
    count = count or available_cores()
    workers = LocalWorkers(count)
    try:
        yield workers, count
    finally:
        workers.shutdown(cancel_futures=True)


def available_cores() -> int:
    """Cores this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextlib.contextmanager
def _cluster(address: str) -> Iterator[tuple[Executor, int]]:
    """Workers of a Dask cluster, by the address of its scheduler.

    Raises:
        InputError: the extra `cluster` is not installed, or nobody answers at the address.
    """
    distributed = need("distributed", extra="cluster", what=f"--cluster {address}")
    try:
        client = distributed.Client(address, timeout=ANSWER_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"--cluster {address}: no Dask scheduler answers: {error}") from error
    with client:
        # Two runs with equal arguments are still two runs: a result must not come from a cache.
        # A client in a plain function is synchronous; its type only knows the other kind.
        threads = cast(dict[str, int], client.nthreads())
        if not threads:
            raise InputError(f"--cluster {address}: the scheduler has no workers")
        shared = {worker: count for worker, count in threads.items() if count > 1}
        if shared:
            # MuJoCo's control callback is one a process: two runs in it would steer each other.
            worker, count = next(iter(shared.items()))
            raise InputError(
                f"--cluster {address}: worker {worker} has {count} threads; allowed is 1 (dask worker --nthreads 1)"
            )
        # Two runs with equal arguments are still two runs: a result must not come from a cache.
        executor = client.get_executor(pure=False)
        try:
            yield executor, len(threads)
        finally:
            executor.shutdown(wait=False)


def death(error: BaseException) -> str | None:
    """What killed the worker of a failed call, or None if the call itself raised."""
    # Named, not imported: the extra that defines the second need not be installed.
    if isinstance(error, WorkerDied) or type(error).__name__ == "KilledWorker":
        return str(error)
    return None


def _one_process() -> ProcessPoolExecutor:
    # Spawned, not forked: a fork would inherit threads and whatever state MuJoCo is in.
    return ProcessPoolExecutor(
        1, mp_context=multiprocessing.get_context("spawn"), initializer=_start
    )


def _start() -> None:
    """In a worker: leave Ctrl-C to the parent, and end with it, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _stop)
    # One thread a worker: the cores are already shared out among the workers.
    for library in ("OPENBLAS", "OMP", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    threading.Thread(target=_follow_parent, daemon=True).start()


_busy = threading.Event()
"""In a worker: set while it makes a run."""


def _call(fn: Callable[..., Any], args: tuple) -> Any:
    _busy.set()
    try:
        return fn(*args)
    finally:
        _busy.clear()


def _stop(number: int, frame: object) -> None:
    """In a worker told to end: leave a run the way Ctrl-C does, so that its folder is removed."""
    if _busy.is_set():
        raise KeyboardInterrupt
    os._exit(0)


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
