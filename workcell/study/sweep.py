"""Many variations of a scenario, in parallel, each judged on its own: `workcell sweep`.

    plan      settings and variations, refused before the first run if they cannot be made
    work      runs handed to workers, a few ahead of them; every result is on disk at once
    conclude  journal -> runs.parquet, one row a run, in order

The folder of a sweep holds what `folder.py` says, summary.md and figures. A run is fixed by (scenario, seed,
number, setting): neither the workers nor their number enter.
"""

from __future__ import annotations

import hashlib
import json
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

from workcell import scenario as scenario_file
from workcell.errors import InputError
from workcell.run import versions
from workcell.study import outcome, workers
from workcell.study.folder import (
    JOURNAL_FILE,
    TABLE_FILE,
    keep_failure,
    kept,
    open_folder,
    write_table,
)
from workcell.study.outcome import Outcome, Report
from workcell.study.vary import Variations, load_variations

KEPT_FAILURES = 50
"""Run folders kept of failed runs; chosen as more than anyone looks through, a few hundred megabytes."""

REASON_LENGTH = 800
"""Characters kept of a defect's traceback: its last few calls."""


@dataclass(frozen=True)
class Plan:
    """What a sweep consists of."""

    variations: dict[str, Variations]
    """By setting: the scenario under that setting, ready to be varied. Without `--compare` one, named ''."""
    runs: int
    """Variations made under each setting, numbers 0 to runs - 1."""
    seed: int
    """Of all draws."""
    asked: dict[str, Any]
    """For sweep.json: everything that fixes the runs."""

    @property
    def size(self) -> int:
        """Number of runs over all settings."""
        return self.runs * len(self.variations)

    def tasks(self, done: set[tuple[int, str]]) -> Iterator[tuple[int, str]]:
        """Numbers and settings of the runs not done yet; the settings of a variation follow each other."""
        for run, setting in product(range(self.runs), self.variations):
            if (run, setting) not in done:
                yield run, setting


@dataclass(frozen=True)
class Progress:
    """How far a sweep is."""

    done: int
    """Runs done, those of an earlier sitting included."""
    total: int
    """Runs asked for."""
    failed: int
    """Runs of this sitting that were no success."""
    simulated_s: float
    """Simulated time of this sitting, s."""
    wall_s: float
    """Time this sitting has taken, s."""


def plan(
    scenario: str,
    *,
    runs: int,
    seed: int,
    compare: tuple[str, ...] = (),
    overrides: tuple[str, ...] = (),
) -> Plan:
    """What to run, refused here if any of it cannot be.

    Args:
        scenario: Name or path.
        runs: Variations under each setting.
        seed: Of all draws.
        compare: `KEY=a,b,c`, each a key of the scenario and its settings; several give all combinations.
        overrides: `KEY=VALUE` that hold for all settings; a key of `[vary]` that is set here is not varied.

    Raises:
        InputError: naming the key of the scenario, of its `[vary]` or of `--compare` that is at fault.
    """
    if runs < 1:
        raise InputError(f"--runs {runs}: allowed is 1 or more")
    if seed < 0:
        raise InputError(f"--seed {seed}: allowed is 0 or more")
    variations = {}
    for choice in product(*(_settings(text) for text in compare)):
        label = " ".join(choice)
        variations[label] = load_variations(scenario, overrides, choice)
        varied = {key.name for key in variations[label].keys}
        for key in sorted(varied & {item.partition("=")[0] for item in choice}):
            raise InputError(
                f'--compare {key}: it is also varied by vary."{key}"; drop one of the two'
            )
        if not varied:
            raise InputError(
                f"{scenario}: has no [vary] table, so all its runs would be the same; "
                'add one, as in [vary] "control.t_min_s" = { min = 0.8, max = 1.2 }'
            )
    first = next(iter(variations.values()))
    asked = {
        "scenario": scenario,
        "set": list(overrides),
        "compare": list(compare),
        "seed": seed,
        "content_sha256": {label: _digest(v) for label, v in variations.items()},
        "vary": list(first.nominal()),
        "versions": versions(),
    }
    return Plan(variations, runs, seed, asked)


def sweep(
    what: Plan,
    out: Path,
    executor: Executor,
    *,
    ahead: int,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
) -> bool:
    """Make the runs of a plan into a folder.

    Args:
        what: The plan.
        out: Folder; made if missing.
        executor: Who makes them.
        ahead: Runs handed out at once; bounds what is held in memory.
        resume: Go on with what is in the folder; without it, a folder that holds a sweep is refused.
        progress: Called after every run.

    Returns:
        Whether all runs have been made; False after Ctrl-C, which keeps those that are.

    Raises:
        InputError: the folder holds a sweep, or another than this one.
    """
    done = open_folder(what.asked, what.runs, out, resume)
    started = time.monotonic()
    folders, failed, simulated_s, complete = len(kept(out)), 0, 0.0, False
    before = len(done)
    try:
        with (out / JOURNAL_FILE).open("a", encoding="utf-8") as journal:
            reports = _reports(
                what, executor, what.tasks(set(done)), ahead, lambda: folders < KEPT_FAILURES
            )
            for report, values in reports:
                row = report.outcome
                journal.write(json.dumps({**asdict(row), "values": values}, allow_nan=False) + "\n")
                journal.flush()
                done.add((row.run, row.setting))
                if row.status != "refused" and not row.success:
                    failed += 1
                if report.files and folders < KEPT_FAILURES:
                    keep_failure(out, report)
                    folders += 1
                simulated_s += row.simulated_s
                if progress:
                    wall_s = time.monotonic() - started
                    progress(Progress(len(done), what.size, failed, simulated_s, wall_s))
        complete = True
    except KeyboardInterrupt:
        # What is in the journal stays; the table below is made of it.
        complete = False
    if len(done) > before or not (out / TABLE_FILE).is_file():
        write_table(out)
    return complete


def make_run(
    scenario: scenario_file.Scenario | None, run: int, setting: str, fault: str, keep: bool
) -> Report:
    """What a worker does: a run, or word that its values do not go together."""
    if scenario is None:
        return Report(Outcome(run, setting, "refused", reason=fault), {})
    return outcome.perform(run, setting, scenario, keep)


def _reports(
    what: Plan,
    executor: Executor,
    tasks: Iterator[tuple[int, str]],
    ahead: int,
    keep: Callable[[], bool],
) -> Iterator[tuple[Report, dict[str, Any]]]:
    """Results as they come, never more than `ahead` runs under way."""
    under_way: dict[Future, tuple[int, str, dict[str, Any]]] = {}
    for run, setting in tasks:
        values = what.variations[setting].draw(what.seed, run)
        try:
            scenario, fault = what.variations[setting].scenario(values), ""
        except InputError as error:
            scenario, fault = None, "; ".join(error.faults)
        future = executor.submit(make_run, scenario, run, setting, fault, keep())
        under_way[future] = (run, setting, values)
        if len(under_way) >= ahead:
            yield from _finished(under_way)
    while under_way:
        yield from _finished(under_way)


def _finished(
    under_way: dict[Future, tuple[int, str, dict[str, Any]]],
) -> Iterator[tuple[Report, dict[str, Any]]]:
    ready, _ = wait(under_way, return_when=FIRST_COMPLETED)
    for future in ready:
        run, setting, values = under_way.pop(future)
        error = future.exception()
        if error is None:
            report = future.result()
            if report.outcome.status == "interrupted":
                raise KeyboardInterrupt
            yield report, values
            continue
        if isinstance(error, KeyboardInterrupt):
            raise error
        # A defect that some run uncovers costs that run, and is told at the end and in its row.
        cause = workers.death(error)
        status, reason = ("error", _last_lines(error)) if cause is None else ("died", cause)
        yield Report(Outcome(run, setting, status, reason=reason), {}), values


def _last_lines(error: BaseException) -> str:
    """What went wrong in a worker, with the line at which it did."""
    return "".join(traceback.format_exception(error.__cause__ or error)).strip()[-REASON_LENGTH:]


def _settings(text: str) -> list[str]:
    key, separator, values = text.partition("=")
    if not separator or not key or not all(values.split(",")):
        raise InputError(
            f"--compare {text!r}: allowed is KEY=VALUE,VALUE,... with a key of the scenario"
        )
    return [f"{key}={value}" for value in values.split(",")]


def _digest(variations: Variations) -> str:
    text = json.dumps([variations.content, variations.laws], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
