"""Modes and events of a recording: a lane for the cell and each arm, a line for every change."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from workcell.trace.table import Trace
from workcell.view.columns import send
from workcell.view.palette import MODE_COLOURS, OTHER_MODE


def log_modes(recording: rr.RecordingStream, trace: Trace) -> None:
    """Lanes of modes, and one event for every change of a mode or a reason."""
    lanes = {"cell": trace["mode"]}
    lanes |= {arm: trace[f"{arm}.mode"] for arm in trace.layout.arms}
    events: list[tuple[int, str, str]] = []
    for lane, mode in lanes.items():
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
        for row in rows.tolist():
            level = "WARN" if mode[row] in ("halt", "stop") else "INFO"
            events.append((row, f"{lane}: {mode[row]}", level))
    entry = trace["entry"]
    events += [
        (row, f"presentations are asked to come from: {entry[row]}", "INFO")
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
            events.append((row, f"{arm}: held back by {reason[row]}{where}", "INFO"))
    events.sort(key=lambda event: event[0])
    rows = np.array([row for row, _, _ in events])
    send(
        recording, trace, "events", rows,
        lambda s: rr.TextLog.columns(
            text=[text for _, text, _ in events[s]], level=[level for _, _, level in events[s]]
        ),
    )  # fmt: skip


def _changes(values: NDArray[np.object_]) -> NDArray[np.int64]:
    """Rows at which a column takes another value, the first included."""
    return np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
