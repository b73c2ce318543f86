"""Rows of a trace as columns of a recording: sent in chunks, on the time lines `sim_time` and `tick`."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from workcell.trace.table import Trace

_CHUNK_ROWS = 4096


def _times(trace: Trace, rows: NDArray[np.int64]) -> list[rr.TimeColumn]:
    # Float seconds would be cut, not rounded, to nanoseconds.
    nanoseconds = np.round(trace["time_s"][rows] * 1e9).astype("timedelta64[ns]")
    return [
        rr.TimeColumn("sim_time", duration=nanoseconds),
        rr.TimeColumn("tick", sequence=trace["tick"][rows]),
    ]


def send(
    recording: rr.RecordingStream,
    trace: Trace,
    entity: str,
    rows: NDArray[np.int64],
    part: Callable[[slice], Iterable[rr.ComponentColumn]],
) -> None:
    """Sends an entity's columns; `part` makes those of a slice of the rows."""
    for start in range(0, len(rows), _CHUNK_ROWS):
        piece = slice(start, start + _CHUNK_ROWS)
        recording.send_columns(entity, _times(trace, rows[piece]), part(piece))
