"""A real Dask scheduler with two worker processes: the same rows, and nothing lost with a worker."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.study.staged import Here
from tests.study.test_sweep import rows, scenario
from workcell.errors import InputError
from workcell.study import workers
from workcell.study.sweep import Progress, plan, sweep
from workcell.study.workers import pool

distributed = pytest.importorskip("distributed")


@pytest.fixture
def cluster() -> Iterator[distributed.LocalCluster]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as local:
        yield local


@pytest.mark.long
def test_a_cluster_gives_the_same_rows_though_a_worker_is_killed(
    cluster: distributed.LocalCluster, tmp_path: Path
):
    what = plan(scenario(tmp_path), runs=6, seed=3)
    sweep(what, tmp_path / "here", Here(), ahead=1)

    def kill_one() -> None:
        time.sleep(1.0)  # in the middle of a run: the first takes longer than this to import MuJoCo
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

    killer: list[threading.Thread] = []

    def after_the_first(now: Progress) -> None:
        if now.done == 1:
            killer.append(threading.Thread(target=kill_one))
            killer[0].start()

    with pool(None, cluster.scheduler_address) as (executor, count):
        assert count == 2
        assert sweep(what, tmp_path / "there", executor, ahead=4, progress=after_the_first)
    killer[0].join()
    assert rows(tmp_path / "there") == rows(tmp_path / "here")
    assert [row["status"] for row in rows(tmp_path / "there")] == ["ran"] * 6


def test_an_address_where_nobody_answers_is_refused(monkeypatch):
    monkeypatch.setattr(workers, "ANSWER_S", 1.0)
    with (
        pytest.raises(InputError, match="no Dask scheduler answers"),
        pool(None, "tcp://127.0.0.1:9"),
    ):
        pass


@pytest.mark.long
def test_workers_with_threads_are_refused():
    """MuJoCo's control callback is one a process."""
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None
        ) as local,
        pytest.raises(InputError, match="has 2 threads; allowed is 1"),
        pool(None, local.scheduler_address),
    ):
        pass
