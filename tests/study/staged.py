"""Executors for tests: one that makes every run at once in this process, one that only pretends."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from workcell.scenario import Scenario
from workcell.study.outcome import Outcome, Report


class Here(Executor):
    """Makes every run as soon as it is submitted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        future: Future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Staged(Executor):
    """Simulates nothing: a given function says what comes of each scenario.

    Args:
        outcome: From (run, setting, scenario) to what its row should say besides.
    """

    def __init__(self, outcome: Callable[[int, str, Scenario], dict[str, Any]]):
        self._outcome = outcome
        self.made: list[tuple[int, str]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        scenario, run, setting, *_ = args
        future: Future = Future()
        self.made.append((run, setting))
        if scenario is None:
            future.set_result(fn(*args))
            return future
        try:
            says = {"status": "ran", "success": True, **self._outcome(run, setting, scenario)}
            future.set_result(Report(Outcome(run=run, setting=setting, **says), {}))
        except BaseException as error:
            future.set_exception(error)
        return future
