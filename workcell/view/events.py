"""Modes and events of a recording: a lane for the cell and each arm, a line for every change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from workcell.trace.readings import STOPPED_MODES
from workcell.trace.table import Trace
from workcell.view.columns import send
from workcell.view.palette import MODE_COLOURS, OTHER_MODE


@dataclass(frozen=True)
class Event:
    """A change worth a line."""

    row: int
    """Row of the trace at which it is seen."""
    text: str
    """What changed, and to what."""
    level: str
    """`WARN` where something stops by decision, else `INFO`."""


def log_modes(recording: rr.RecordingStream, trace: Trace) -> None:
    """Lanes of modes, and one event for every change of a mode or a reason."""
    for lane, mode in lanes(trace).items():
        rows = _changes(mode)
        names = sorted(set(mode))
        recording.log(
            f"mode/{lane}",
            rr.StateConfiguration(
                values=names,
                labels=names,
                colors=[list(MODE_COLOURS.get(name, OTHER_MODE)) for name in names],
            ),
            static=True,
        )
        send(
            recording, trace, f"mode/{lane}", rows,
            lambda s, states=mode[rows]: rr.StateChange.columns(state=states[s]),
        )  # fmt: skip
    events = events_of(trace)
    send(
        recording, trace, "events", np.array([event.row for event in events]),
        lambda s: rr.TextLog.columns(
            text=[event.text for event in events[s]], level=[event.level for event in events[s]]
        ),
    )  # fmt: skip


def lanes(trace: Trace) -> dict[str, NDArray[np.object_]]:
    """The mode of the cell and of every arm, (T,) each."""
    return {"cell": trace["mode"]} | {arm: trace[f"{arm}.mode"] for arm in trace.layout.arms}


def events_of(trace: Trace) -> list[Event]:
    """Every change of a mode, a reason or the side of approach, in order of time."""
    events = [
        Event(row, f"{lane}: {mode[row]}", "WARN" if mode[row] in STOPPED_MODES else "INFO")
        for lane, mode in lanes(trace).items()
        for row in _changes(mode).tolist()
    ]
    entry = trace["entry"]
    events += [
        Event(row, f"presentations are asked to come from: {entry[row]}", "INFO")
        for row in _changes(entry).tolist()
        if entry[row]
    ]
    for arm in trace.layout.arms:
        reason = trace[f"{arm}.reason"]
        limiting = trace[f"{arm}.limiting_pair"]
        for row in _changes(reason).tolist():
            if not reason[row]:
                continue
            pair = int(limiting[row])
            where = f" ({' and '.join(trace.layout.pairs[pair])})" if pair >= 0 else ""
            events.append(Event(row, f"{arm}: held back by {reason[row]}{where}", "INFO"))
    return sorted(events, key=lambda event: event.row)


def _changes(values: NDArray[np.object_]) -> NDArray[np.int64]:
    """Rows at which a column takes another value, the first included."""
    return np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
