"""Many variations of a scenario, in parallel, each judged on its own: `workcell sweep`.

    plan      settings and variations, refused before the first run if they cannot be made
    work      runs handed to workers, a few ahead of them; every result is on disk at once
    conclude  journal -> runs.parquet, one row a run, in order

The folder of a sweep: sweep.json (what was asked), runs.jsonl (the journal, a line a run, while
it lasts and for `--resume`), runs.parquet, failures/ (run folders with the command that makes
them again), summary.md and figures. A run is fixed by (scenario, seed, number, setting): neither the
workers nor their number enter.
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
from workcell.study.outcome import Outcome, Report
from workcell.study.vary import Variations, load_variations

PLAN_FILE = "sweep.json"
JOURNAL_FILE = "runs.jsonl"
TABLE_FILE = "runs.parquet"
FAILURES_FOLDER = "failures"

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
    done = _open(what, out, resume)
    started = time.monotonic()
    kept, failed, simulated_s, complete = len(_kept(out)), 0, 0.0, False
    before = len(done)
    try:
        with (out / JOURNAL_FILE).open("a", encoding="utf-8") as journal:
            reports = _reports(
                what, executor, what.tasks(set(done)), ahead, lambda: kept < KEPT_FAILURES
            )
            for report, values in reports:
                row = report.outcome
                journal.write(json.dumps({**asdict(row), "values": values}, allow_nan=False) + "\n")
                journal.flush()
                done.add((row.run, row.setting))
                if row.status != "refused" and not row.success:
                    failed += 1
                if report.files and kept < KEPT_FAILURES:
                    _keep(out, report)
                    kept += 1
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


def write_table(out: Path) -> Path:
    """runs.parquet from the journal, rows in the order of runs and settings; torn lines are left out."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    asked = json.loads((out / PLAN_FILE).read_text(encoding="utf-8"))
    order = {setting: place for place, setting in enumerate(asked["content_sha256"])}
    lines = sorted(_journal(out), key=lambda line: (line["run"], order[line["setting"]]))
    columns: dict[str, Any] = {name: [line[name] for line in lines] for name in outcome.COLUMNS}
    for key in asked["vary"]:
        values = [line["values"].get(key) for line in lines]
        # A choice may mix types, which a column cannot: those are kept as text.
        plain = len({type(v) for v in values}) == 1
        columns[f"vary.{key}"] = values if plain else [json.dumps(v) for v in values]
    pq.write_table(pa.table(columns), out / TABLE_FILE)
    return out / TABLE_FILE


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


def _open(what: Plan, out: Path, resume: bool) -> set[tuple[int, str]]:
    """Make or reopen the folder of a sweep; returns the runs it already holds."""
    plan_file = out / PLAN_FILE
    if plan_file.is_file():
        if not resume:
            raise InputError(
                f"--out {out}: holds a sweep; say --resume to go on with it, or name another folder"
            )
        there = json.loads(plan_file.read_text(encoding="utf-8"))
        differing = [key for key, value in what.asked.items() if there.get(key) != value]
        if differing:
            raise InputError(
                f"--resume: the sweep in {out} differs from what is asked now in {', '.join(differing)}"
            )
        _drop_torn_line(out / JOURNAL_FILE)
    else:
        out.mkdir(parents=True, exist_ok=True)
        plan_file.write_text(json.dumps(what.asked, indent=2) + "\n", encoding="utf-8")
        (out / JOURNAL_FILE).write_text("", encoding="utf-8")
    # A run that its worker did not survive, or a defect broke off, is made again.
    return {
        (line["run"], line["setting"])
        for line in _journal(out)
        if line["run"] < what.runs and line["status"] not in ("died", "error")
    }


def _journal(out: Path) -> list[dict[str, Any]]:
    """Whole lines of the journal, the last of each run."""
    latest: dict[tuple[int, str], dict[str, Any]] = {}
    for line in (out / JOURNAL_FILE).read_text(encoding="utf-8").splitlines(keepends=True):
        if line.endswith("\n"):
            row = json.loads(line)
            latest[row["run"], row["setting"]] = row
    return list(latest.values())


def _drop_torn_line(journal: Path) -> None:
    """Cut off what a kill left of a last line, so that the next one does not continue it."""
    text = journal.read_bytes()
    journal.write_bytes(text[: text.rfind(b"\n") + 1])


def _kept(out: Path) -> list[Path]:
    return sorted((out / FAILURES_FOLDER).glob("*/"))


def _keep(out: Path, report: Report) -> None:
    folder = out / FAILURES_FOLDER / folder_name(report.outcome.run, report.outcome.setting)
    for name, content in report.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    command = f"workcell run {folder / 'scenario.toml'} --out {folder.name}_again"
    (folder / "reproduce.txt").write_text(command + "\n", encoding="utf-8")


def folder_name(run: int, setting: str) -> str:
    """Name of the folder of one run among those of a sweep."""
    label = "".join(c if c.isalnum() or c in "._-" else "_" for c in setting.replace("=", "-"))
    return f"{run:05d}{'_' + label if label else ''}"
