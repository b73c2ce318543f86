"""The four instants that tell the story of a run, for pictures of the cell and marks in figures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workcell.trace.readings import (
    Span,
    period_s,
    scaled_down,
    smallest_distance_m,
    spans,
    support_arm,
)
from workcell.trace.table import Trace

ENCOUNTER_GAP_S = 0.5
"""Scaling that pauses for less is one encounter: chosen to bridge a change of witness points."""
ENCOUNTER_LEAST_S = 0.1
"""Scaling for less is a passing change of witness points, too short for an onlooker to see."""


def time_stamps(trace: Trace) -> tuple[int, int, int, int]:
    """The four instants that tell the story of a run, as ticks of the trace, in order.

    Scaling of the support arm up to the first halt falls into encounters. With two or more: onset
    of the first, the smallest distance around it, onset of the last, and the halt or else the
    smallest distance of the last. With one: onset, two between, and its end. Without any: four
    evenly spread.
    """
    count = len(trace)
    even = np.linspace(0, count - 1, 6)[1:5].astype(int)
    halts = np.flatnonzero(trace["mode"] == "halt")
    halt = int(halts[0]) if halts.size else None
    encounters = _encounters(trace, count if halt is None else halt)
    if not encounters:
        return _four(even)
    distance_m = smallest_distance_m(trace)

    def closest(start: int, stop: int) -> int:
        return start + int(np.argmin(distance_m[start:stop]))

    first, last = encounters[0], encounters[-1]
    end = closest(last.start, last.stop) if halt is None else halt
    if len(encounters) > 1:
        # The closest moment may follow just after the speed is free again.
        margin = round(ENCOUNTER_GAP_S / period_s(trace))
        around = closest(first.start, min(first.stop + margin, encounters[1].start))
        story = np.array([first.start, around, last.start, end])
    else:
        story = np.linspace(first.start, end, 4).astype(int)
    return _four(story if np.all(np.diff(story) > 0) else even)


def _encounters(trace: Trace, stop: int) -> list[Span]:
    """Times of scaling of the support arm before a tick, short pauses bridged, blips left out."""
    dt_s = period_s(trace)
    found: list[Span] = []
    for span in spans(scaled_down(trace, support_arm(trace))[:stop]):
        if found and (span.start - found[-1].stop) * dt_s < ENCOUNTER_GAP_S:
            span = Span(found.pop().start, span.stop)
        found.append(span)
    return [span for span in found if len(span) * dt_s >= ENCOUNTER_LEAST_S]


def _four(ticks: NDArray[np.int64]) -> tuple[int, int, int, int]:
    one, two, three, four = (int(tick) for tick in ticks)
    return one, two, three, four
