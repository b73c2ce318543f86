"""References of scenarios: what a controller did, kept as text, so that a change cannot go unseen.

A reference is a folder: `scenario.toml` (the scenario as it was run), `reference.json` (arms, joints,
pairs, metrics), `closed_loop.csv` (what the run gave), `states.csv` (what its controller was fed) and
`open_loop.csv` (what the controller answers to just that). This file reads one and holds today's
controller against it; `workcell.regression.bless` writes one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.errors import TraceError
from workcell.files import read_object
from workcell.regression import replay
from workcell.regression.compare import Comparison, compare
from workcell.regression.excerpt import Excerpt, Identity, excerpt
from workcell.regression.rows import read_rows, read_states
from workcell.scenario import Bound, Scenario
from workcell.signals import Layout
from workcell.trace import metrics
from workcell.trace.table import Trace

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

ROW_FILES = {"open": "open_loop.csv", "closed": "closed_loop.csv"}
STATES_FILE, ABOUT_FILE = "states.csv", "reference.json"


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
        return read_rows(self.folder / ROW_FILES[loop], self.identity, self.length)


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
    return sorted(path.parent.name for path in references.glob(f"*/{ABOUT_FILE}"))


def is_reference(folder: Path) -> bool:
    """Whether a folder holds a reference, not a run."""
    return (folder / ABOUT_FILE).is_file()


def load(folder: Path) -> Reference:
    """Read a reference.

    Raises:
        TraceError: it is missing or incomplete.
        InputError: its scenario is none this version can read.
    """
    try:
        about = read_object(folder / ABOUT_FILE)
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
    fed = read_states(reference.folder / STATES_FILE, cell.period_s)
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


def _same_metric(now: Any, was: Any) -> bool:
    if any(isinstance(x, (bool, str)) or x is None for x in (now, was)):
        return now == was
    if isinstance(now, int) and isinstance(was, int):
        return abs(now - was) <= max(COUNT_ATOL, METRIC_RTOL * abs(was))
    return math.isclose(now, was, rel_tol=METRIC_RTOL, abs_tol=METRIC_ATOL)
