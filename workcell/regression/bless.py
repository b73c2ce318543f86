"""The one way to change a reference: with a reason, a log, and every expectation held.

In comes the name of a scenario; out come the files of its reference (`workcell.regression.reference`)
and the metrics that changed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.errors import InputError, TraceError
from workcell.regression import replay
from workcell.regression.excerpt import identity
from workcell.regression.reference import (
    ABOUT_FILE,
    ROW_FILES,
    STATES_FILE,
    MetricChange,
    is_reference,
    load,
    unmet,
)
from workcell.regression.rows import read_states, write_rows, write_states
from workcell.scenario import Scenario
from workcell.trace.table import Trace

OVERRIDES = ("simulation.plant=kinematic", "simulation.period_s=0.02")
"""How references are run unless told otherwise: without physics, whose changes are not ours to hold
still, and with a tenth of the ticks, so that all scenarios can be replayed at every change."""

INPUTS = ("qpos", "qvel", "check_state", "check_distance_m")
"""Signals that an open loop is fed; comparing them would say nothing."""

LOG = "LOG.md"


def bless(
    name: str,
    references: Path,
    reason: str,
    *,
    out: Path,
    overrides: Sequence[str] | None = None,
    progress: replay.Progress | None = None,
) -> list[MetricChange]:
    """Make what a scenario does now its reference.

    Args:
        name: A shipped scenario, or the path of one.
        references: Folder of all references and of their log.
        reason: Why the behaviour changed, for the log.
        out: Folder for the runs, to look at them.
        overrides: Settings of the reference run; None keeps those of the present reference, and
            `OVERRIDES` if there is none.
        progress: Called with (ticks done, ticks in all) of each run.

    Returns:
        The metrics that changed.

    Raises:
        InputError: no reason, nothing is expected of the scenario, or an expectation is broken, by the
            scenario as it is shipped or by the reference run.
    """
    if not reason.strip():
        raise InputError('REASON: a reference changes for a reason; say it, as in REASON="..."')
    shipped = scenario_file.load(name)
    if not shipped.expect:
        raise InputError(
            "expect: nothing is expected of this scenario, so that nobody would see it stop "
            "engaging what it is meant to; put bounds on metrics of the summary",
            file=shipped.file,
        )
    folder = references / shipped.name
    old = load(folder) if is_reference(folder) else None
    if overrides is None:
        overrides = OVERRIDES if old is None else old.overrides
    _judged(shipped, out / "shipped", progress)
    again = _judged(scenario_file.load(name, tuple(overrides)), out / "closed_loop", progress)
    if again.summary is None:  # A closed loop always has one; the type does not know.
        raise TraceError(f"{again.trace.source}: has no summary")
    new = again.summary["metrics"]
    _write(folder, again.trace, tuple(overrides), new, out / "open_loop", progress)
    changes = [
        MetricChange(key, _rounded(new.get(key)), None if old is None else old.metrics.get(key))
        for key in {**(old.metrics if old else {}), **new}
        if old is None or _rounded(new.get(key)) != old.metrics.get(key)
    ]
    _log(references / LOG, shipped.name, reason, changes, new=old is None)
    return changes


def _judged(scenario: Scenario, out: Path, progress: replay.Progress | None) -> replay.Replay:
    """A run that keeps its expectations; any other is refused."""
    again = replay.closed_loop(scenario, out, progress=progress)
    broken = unmet(again.summary or {})
    if broken:
        raise InputError(
            [f"not blessed: with {out.name} settings {line}" for line in broken], file=scenario.file
        )
    return again


def _write(
    folder: Path,
    trace: Trace,
    overrides: tuple[str, ...],
    measured: Mapping[str, Any],
    out: Path,
    progress: replay.Progress | None,
) -> None:
    """Write all files of a reference from its closed loop."""
    scenario = replay.scenario_of(trace)
    who = identity(trace)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / runner.SCENARIO_FILE).write_text(scenario.to_toml(), encoding="utf-8")
    write_rows(folder / ROW_FILES["closed"], trace)
    write_states(folder / STATES_FILE, trace)
    cell = runner.prepare(scenario, out / runner.SCENE_FOLDER)
    fed = read_states(folder / STATES_FILE, cell.period_s)
    answer = replay.open_loop(cell, fed, out, progress=progress)
    if answer.fault:
        raise InputError(f"not blessed: open loop: {answer.fault}", file=scenario.file)
    write_rows(folder / ROW_FILES["open"], answer.trace, skip=INPUTS)
    about = {
        "schema_version": who.schema_version,
        "ticks": len(trace),
        "overrides": list(overrides),
        "arms": who.layout.arms,
        "joints": who.layout.joints,
        "nq": who.layout.nq,
        "nv": who.layout.nv,
        "versions": who.versions,
        "platform": who.platform,
        "metrics": {key: _rounded(value) for key, value in measured.items()},
        "pairs": who.layout.pairs,
    }
    text = json.dumps(about, indent=1, allow_nan=False)
    (folder / ABOUT_FILE).write_text(text + "\n", encoding="utf-8")


def _log(path: Path, name: str, reason: str, changes: list[MetricChange], *, new: bool) -> None:
    """Append to the log of references: when, why, and what it did to the metrics."""
    lines = [] if path.is_file() else ["# Changes of the references\n"]
    lines += [f"\n## {datetime.now(UTC):%Y-%m-%d} {name}{' (new)' if new else ''}\n", f"{reason}\n"]
    if changes:
        lines += ["| metric | before | now |", "|---|---|---|"]
        lines += [
            f"| {change.name} | {_cell(change.reference)} | {_cell(change.now)} |"
            for change in changes
        ]
    else:
        lines.append("No metric changed.")
    with path.open("a", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")


def _rounded(value: Any) -> Any:
    """Eight digits: far beyond what is compared, and the same on every machine more often than not."""
    return float(f"{value:.8g}") if isinstance(value, float) else value


def _cell(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "none" if value is None else str(value)
