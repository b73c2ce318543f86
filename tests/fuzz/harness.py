"""Calls of the command line, watched: exit status, message, time, memory.

A call must end with a documented exit status, say why in fewer than 2,000 characters where it refuses, show no
traceback, and take neither a minute nor two gigabytes.
"""

from __future__ import annotations

import contextlib
import io
import os
import resource
import signal
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from workcell import cli

LONGEST_S = 60.0
LONGEST_REFUSAL_S = 15.0
"""Five seconds on a machine of one's own, with room for one that is shared."""
REFUSAL_LENGTH = 2000
MEMORY_BYTES = 2 * 1024**3
STATUSES = (0, 1, 2)


class TooLong(BaseException):
    """A call was stopped after `LONGEST_S`."""


@dataclass(frozen=True)
class Call:
    """What came of one call."""

    arguments: tuple[str, ...]
    status: int | None
    """None where it ended with an exception."""
    out: str
    err: str
    took_s: float

    @property
    def faults(self) -> list[str]:
        """What no call may do."""
        found = []
        if self.status not in STATUSES:
            found.append(f"status {self.status}")
        if "Traceback (most recent call last)" in self.err + self.out:
            found.append("traceback")
        if self.status == 2 and not self.err.strip():
            found.append("refused without a word")
        if self.status == 2 and len(self.err) > REFUSAL_LENGTH:
            found.append(f"a message of {len(self.err)} characters")
        if self.status == 2 and self.took_s > LONGEST_REFUSAL_S:
            found.append(f"refused after {self.took_s:.0f} s")
        if self.took_s > LONGEST_S:
            found.append(f"took {self.took_s:.0f} s")
        return found


@dataclass
class Case:
    """One mutated input: the calls made with it, and what was wrong with them."""

    target: str
    seed: int
    calls: list[Call] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    judged: int = 0
    """Runs of which the judge was asked."""

    def call(self, *arguments: str) -> Call:
        """Call the command line and note what it may not do."""
        made = call(arguments)
        self.calls.append(made)
        self.faults += [f"{' '.join(arguments)[:200]}: {fault}" for fault in made.faults]
        return made


def call(arguments: Sequence[str]) -> Call:
    """One call in this process."""
    out, err = io.StringIO(), io.StringIO()
    started = time.monotonic()

    def stop(*_: object) -> None:
        raise TooLong

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                status: int | None = cli.main(list(arguments))
            except SystemExit as ended:
                status = ended.code if isinstance(ended.code, int) else 2
            except TooLong:
                status = None
                err.write(f"stopped after {LONGEST_S:g} s")
            except BaseException:
                status = None
                traceback.print_exc(file=err)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    return Call(
        tuple(arguments), status, out.getvalue(), err.getvalue(), time.monotonic() - started
    )


Target = Callable[[Case, Path], None]
"""Makes an input of the case's seed in a folder, and calls commands with it."""


def run(name: str, target: Target, seeds: Sequence[int]) -> Iterator[Case]:
    """All cases of one target; a case that needs too much memory has that as its fault."""
    for seed in seeds:
        case = Case(name, seed)
        before = _peak_bytes()
        with tempfile.TemporaryDirectory() as folder:
            here = os.getcwd()
            os.chdir(folder)
            try:
                target(case, Path(folder))
            finally:
                os.chdir(here)
        if _peak_bytes() > max(before, MEMORY_BYTES):
            case.faults.append(f"needed {_peak_bytes() / 1e9:.1f} GB")
        yield case


def _peak_bytes() -> int:
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
