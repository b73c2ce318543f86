"""References of scenarios: what a controller did, kept as text, so that a change cannot go unseen.

A reference is a folder: `scenario.toml` (the scenario as it was run), `reference.json` (arms, joints,
pairs, metrics), `closed_loop.csv` (what the run gave), `states.csv` (what its controller was fed) and
`open_loop.csv` (what the controller answers to just that). It is written by `bless` alone, which
takes a reason, keeps a log, and refuses a run that breaks its own expectations.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.errors import InputError, TraceError
from workcell.regression import replay
from workcell.regression.compare import Comparison, Excerpt, Identity, compare, excerpt, identity
from workcell.regression.reference import read_rows, read_states, write_rows, write_states
from workcell.scenario import Bound, Scenario
from workcell.signals import Layout
from workcell.trace import metrics
from workcell.trace.table import Trace

OVERRIDES = ("simulation.plant=kinematic", "simulation.period_s=0.02")
"""How references are run unless told otherwise: without physics, whose changes are not ours to hold
still, and with a tenth of the ticks, so that all scenarios can be replayed at every change."""

INPUTS = ("qpos", "qvel", "check_state", "check_distance_m")
"""Signals that an open loop is fed; comparing them would say nothing."""

WIDEN_CLOSED = 10.0
"""Factor on the tolerances of a closed loop, where a difference of a tick is fed back into the next."""
SLACK_TICKS = 2
"""How much earlier or later a closed loop may switch: a threshold that is met within rounding."""

METRIC_RTOL, METRIC_ATOL, COUNT_ATOL = 0.01, 1e-4, 2 * SLACK_TICKS
"""What metrics of a closed loop may differ by: a percent, or where they are near zero a tenth of a
millimetre, millimetre a second, ... ; counts of ticks by what the slack at two switches makes of them."""
OF_AN_EXTREME = ("_time_s", "_pair", "_reason")
"""Ends of metrics that say where an extreme was: of two equal ones rounding picks either."""

CLOSED: dict[str, Any] = {"widen": WIDEN_CLOSED, "slack_ticks": SLACK_TICKS}
"""What two closed loops are compared with."""

LOG = "LOG.md"
_ROWS = {"open": "open_loop.csv", "closed": "closed_loop.csv"}
_STATES, _ABOUT = "states.csv", "reference.json"


@dataclass(frozen=True)
class Reference:
    """A reference as it lies on disk."""

    folder: Path
    """Its folder, named after the scenario."""
    scenario: Scenario
    """The scenario as it was run."""
    overrides: tuple[str, ...]
    """What makes it of the shipped one."""
    identity: Identity
    """Arms, joints, pairs, versions."""
    length: int
    """Ticks of the run."""
    metrics: Mapping[str, Any]
    """Metrics of the closed loop."""

    def rows(self, loop: str) -> Excerpt:
        """What the controller put out in the `open` or the `closed` loop."""
        return read_rows(self.folder / _ROWS[loop], self.identity, self.length)


@dataclass(frozen=True)
class MetricChange:
    """A metric that is not what it was."""

    name: str
    """Its name."""
    now: Any
    """What it is."""
    reference: Any
    """What it was."""


@dataclass(frozen=True)
class ClosedLoop:
    """A scenario run again and held against its reference."""

    unmet: tuple[str, ...]
    """Expectations that no longer hold."""
    metrics: tuple[MetricChange, ...]
    """Metrics that changed; looked at before any signal."""
    comparison: Comparison
    """The signals."""

    @property
    def same(self) -> bool:
        """Whether nothing changed."""
        return not self.unmet and not self.metrics and self.comparison.kind == "same"


def names(references: Path) -> list[str]:
    """Scenarios that have a reference in this folder."""
    return sorted(path.parent.name for path in references.glob(f"*/{_ABOUT}"))


def is_reference(folder: Path) -> bool:
    """Whether a folder holds a reference, not a run."""
    return (folder / _ABOUT).is_file()


def load(folder: Path) -> Reference:
    """Read a reference.

    Raises:
        TraceError: it is missing or incomplete.
        InputError: its scenario is none this version can read.
    """
    try:
        about = json.loads((folder / _ABOUT).read_text(encoding="utf-8"))
        scenario = scenario_file.load(folder / runner.SCENARIO_FILE)
        layout = Layout(
            arms=tuple(about["arms"]),
            joints=tuple(about["joints"]),
            nq=about["nq"],
            nv=about["nv"],
            pairs=tuple((g, h) for g, h in about["pairs"]),
        )
        return Reference(
            folder=folder,
            scenario=scenario,
            overrides=tuple(about["overrides"]),
            identity=Identity(
                schema_version=about["schema_version"],
                layout=layout,
                settings=scenario.model_dump(mode="json"),
                versions=about["versions"],
                platform=about["platform"],
            ),
            length=about["ticks"],
            metrics=about["metrics"],
        )
    except (OSError, ValueError, KeyError) as error:
        raise TraceError(f"{folder}: is no reference: {error!r}") from error


def check_open_loop(reference: Reference, out: Path) -> Comparison:
    """Feed a reference's states to today's controller and compare what it answers."""
    cell = runner.prepare(reference.scenario, out / runner.SCENE_FOLDER)
    fed = read_states(reference.folder / _STATES, cell.period_s)
    again = replay.open_loop(cell, fed, out)
    return compare(excerpt(again.trace), reference.rows("open"), without_plant=True)


def check_closed_loop(
    reference: Reference, out: Path, *, expect: Mapping[str, Bound] | None = None
) -> ClosedLoop:
    """Run a reference's scenario again: expectations first, then metrics, then signals.

    Args:
        reference: What it was.
        out: Folder for the run.
        expect: What is expected of it; None for what was expected when it was blessed.
    """
    scenario = reference.scenario
    if expect is not None:
        scenario = scenario.model_copy(update={"expect": dict(expect)})
    again = replay.closed_loop(scenario, out)
    summary = again.summary or {}
    return ClosedLoop(
        unmet=unmet(summary),
        metrics=metric_changes(summary["metrics"], reference.metrics),
        comparison=compare(
            excerpt(again.trace),
            reference.rows("closed"),
            **CLOSED,
        ),
    )


def metric_changes_of_trace(trace: Trace, reference: Mapping[str, Any]) -> tuple[MetricChange, ...]:
    """The same for a trace alone, which does not tell how its run ended."""
    now = metrics_of(trace)
    return metric_changes(now, {name: was for name, was in reference.items() if name in now})


def metric_changes(
    now: Mapping[str, Any], reference: Mapping[str, Any]
) -> tuple[MetricChange, ...]:
    """Metrics of the reference that the run does not give again; those it did not know are new, not changed."""
    return tuple(
        MetricChange(name, now.get(name), was)
        for name, was in reference.items()
        if not name.endswith(OF_AN_EXTREME) and not _same_metric(now.get(name), was)
    )


def metrics_of(trace: Trace) -> dict[str, Any]:
    """The metrics a recorded run had, as far as the trace tells."""
    return dict(metrics.summarise(trace))


def unmet(summary: Mapping[str, Any]) -> tuple[str, ...]:
    """Expectations of a summary that do not hold, and a fault if there was one."""
    faults = [f"fault: {summary['metrics']['fault']}"] if summary["metrics"]["fault"] else []
    return (
        *faults,
        *(
            f"{name} is {verdict['measured']}, wanted {verdict['wanted']}"
            for name, verdict in summary["expectations"].items()
            if not verdict["held"]
        ),
    )


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
    write_rows(folder / _ROWS["closed"], trace)
    write_states(folder / _STATES, trace)
    cell = runner.prepare(scenario, out / runner.SCENE_FOLDER)
    fed = read_states(folder / _STATES, cell.period_s)
    answer = replay.open_loop(cell, fed, out, progress=progress)
    if answer.fault:
        raise InputError(f"not blessed: open loop: {answer.fault}", file=scenario.file)
    write_rows(folder / _ROWS["open"], answer.trace, skip=INPUTS)
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
    (folder / _ABOUT).write_text(text + "\n", encoding="utf-8")


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


def _same_metric(now: Any, was: Any) -> bool:
    if any(isinstance(x, (bool, str)) or x is None for x in (now, was)):
        return now == was
    if isinstance(now, int) and isinstance(was, int):
        return abs(now - was) <= max(COUNT_ATOL, METRIC_RTOL * abs(was))
    return math.isclose(now, was, rel_tol=METRIC_RTOL, abs_tol=METRIC_ATOL)


def _rounded(value: Any) -> Any:
    """Eight digits: far beyond what is compared, and the same on every machine more often than not."""
    return float(f"{value:.8g}") if isinstance(value, float) else value


def _cell(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "none" if value is None else str(value)
