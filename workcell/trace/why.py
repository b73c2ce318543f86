"""Why a run was not as expected, in words, read off its trace.

In come a trace and what the summary says so far; out come sentences for people: what broke, which arm was at
which job since when, what held it back, which pair that was, what was tried, and what the inverse kinematics
said of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.trace.metrics import DONE_JOB
from workcell.trace.readings import jobs_of, period_s
from workcell.trace.table import Trace

LOOKED_AT_S = 5.0
"""The end of a run that its state is told of: long against a dwell or a try, short against a job."""
SOLVED = "optimal"
REASONS = {
    "ttc": "the time to collision would fall below t_min",
    "other_arm": "another arm comes nearer by itself",
    "rise": "its speed scale may rise only slowly",
    "acceleration": "its joints cannot speed up faster",
    "braking": "its joints cannot brake faster",
}
"""What the commonest reasons in the trace mean; others are told as they are."""


def why(trace: Trace, summary: Mapping[str, Any]) -> list[str]:
    """Sentences on what kept a run from what was expected of it; empty for a run that held.

    Args:
        trace: Of the run, with at least one row.
        summary: With `held`, `expectations`, `metrics` and `final_check` as in summary.json.
    """
    if summary["held"]:
        return []
    return [*_endings(summary), *_expectations(summary), *_arms(trace)]


def _endings(summary: Mapping[str, Any]) -> Iterator[str]:
    metrics = summary["metrics"]
    if metrics["interrupted"]:
        yield "A person stopped the run."
    if metrics["fault"]:
        yield f"The run ended before its time: {metrics['fault']}."
    if metrics.get("contact"):
        yield f"Parts touched (contact_cause: {metrics['contact_cause']}); `workcell judge` says which and when."
    halt = summary["final_check"].get("halt")
    if halt:
        yield f"The final check stopped the arms ({halt['state']}): {halt['reason']}."


def _expectations(summary: Mapping[str, Any]) -> Iterator[str]:
    for name, verdict in summary["expectations"].items():
        if not verdict["held"]:
            yield f"Expected of {name} was {verdict['wanted']}, it is {verdict['measured']}."


def _arms(trace: Trace) -> Iterator[str]:
    """Where each arm whose jobs are not done stood at the end."""
    for arm in trace.layout.arms:
        job = trace[f"{arm}.job"].astype(str)
        if not jobs_of(trace, arm) or job[-1] == DONE_JOB:
            continue
        since = _since(job)
        time_s = trace["time_s"]
        last = np.arange(len(trace)) >= max(
            since, len(trace) - round(LOOKED_AT_S / period_s(trace))
        )
        parts = [
            f"{arm} was at its job {job[-1]} since {time_s[since]:.1f} s, {1e3 * trace[f'{arm}.tool_error_m'][-1]:.0f} mm off its path"
        ]
        parts += _held_back(trace, arm, last)
        tried = sorted(set(trace[f"{arm}.attempt"].astype(str)[since:].tolist()) - {""})
        parts.append(
            f"tried: {', '.join(tried)}" if tried else "nothing was tried against an impasse"
        )
        parts += _inverse_kinematics(trace, arm, last)
        yield "; ".join(parts) + "."


def _since(values: NDArray[np.str_]) -> int:
    """First row of the last stretch of equal values."""
    changes = np.flatnonzero(values[1:] != values[:-1])
    return int(changes[-1]) + 1 if changes.size else 0


def _held_back(trace: Trace, arm: str, last: NDArray[np.bool_]) -> Iterator[str]:
    """The commonest reason of the last seconds, and the pair that it was due to."""
    reason = trace[f"{arm}.reason"].astype(str)[last]
    names, counts = np.unique(reason[reason != ""], return_counts=True)
    if not names.size:
        yield "nothing held it back at the end"
        return
    name = str(names[np.argmax(counts)])
    share = counts.max() / len(reason)
    text = f"in {100 * share:.0f} % of its last ticks held back since {REASONS.get(name, name)}"
    pair = trace[f"{arm}.limiting_pair"][last][reason == name]
    known, times = np.unique(pair[pair >= 0], return_counts=True)
    if known.size:
        text += " (" + " and ".join(trace.layout.pairs[int(known[np.argmax(times)])]) + ")"
    yield text


def _inverse_kinematics(trace: Trace, arm: str, last: NDArray[np.bool_]) -> Iterator[str]:
    status = trace[f"{arm}.ik_status"].astype(str)[last]
    for name, count in zip(*np.unique(status, return_counts=True), strict=True):
        if name not in ("", SOLVED):
            yield f"the inverse kinematics said {name} in {count} of {len(status)} ticks"
