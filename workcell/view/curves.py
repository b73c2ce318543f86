"""The curves of a recording: times to collision, distances, ARTC, tool speeds and scales."""

from __future__ import annotations

from typing import Literal

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from workcell.trace.readings import control_setting, smallest_distance_m
from workcell.trace.table import Trace
from workcell.view.columns import send
from workcell.view.limits import FALLBACK_T_MIN_S, TTC_CAP_IN_T_MIN
from workcell.view.palette import COMMANDED, LIMIT, MEASURED, Rgb, arm_colour


def log_curves(recording: rr.RecordingStream, trace: Trace) -> None:
    every = np.arange(len(trace))
    arms = trace.layout.arms
    colours = [arm_colour(k) for k in range(len(arms))]

    def curves(
        entity: str,
        series: dict[str, NDArray[np.float64]],
        colours: list[Rgb],
        aggregation: Literal["Min", "Max"],
    ) -> None:
        if not series:
            return
        values = np.column_stack(list(series.values()))
        # When a pixel covers several ticks it must show the extreme that matters, not a mean.
        style = rr.SeriesLines(
            names=list(series), colors=[list(c) for c in colours], aggregation_policy=aggregation
        )
        recording.log(entity, style, static=True)
        send(recording, trace, entity, every, lambda s: rr.Scalars.columns(scalars=values[s]))

    def level(value: float) -> NDArray[np.float64]:
        return np.full(len(trace), value)

    t_min_s = control_setting(trace, "t_min_s")
    cap_s = TTC_CAP_IN_T_MIN * (t_min_s or FALLBACK_T_MIN_S)
    ttc, ttc_colours = {}, []
    # Later series are drawn over earlier ones, and scaling lays the curves onto the limit.
    if t_min_s is not None:
        ttc["t_min"] = level(t_min_s)
        ttc_colours.append(LIMIT)
    ttc["commanded"] = _capped(trace["ttc_command_s"], cap_s)
    ttc["measured"] = _capped(trace["ttc_s"], cap_s)
    ttc_colours += [COMMANDED, MEASURED]
    curves("ttc", ttc, ttc_colours, "Min")
    distance, distance_colours = {}, []
    if trace.layout.pairs:
        distance["capsules"] = smallest_distance_m(trace)
        distance_colours.append(MEASURED)
    if np.isfinite(trace["check_distance_m"]).any():
        distance["final check"] = _gap(trace["check_distance_m"])
        distance_colours.append(COMMANDED)
    d_min_m = control_setting(trace, "d_min_m")
    if d_min_m is not None:
        distance["d_min"] = level(d_min_m)
        distance_colours.append(LIMIT)
    curves("distance", distance, distance_colours, "Min")

    def per_arm(column: str) -> dict[str, NDArray[np.float64]]:
        return {arm: trace[f"{arm}.{column}"] for arm in arms}

    curves("artc", per_arm("artc_per_s"), colours, "Max")
    curves("tool_speed", per_arm("tool_speed_m_s"), colours, "Max")
    curves("scale", per_arm("scale"), colours, "Min")


def _capped(ttc_s: NDArray[np.float64], cap_s: float) -> NDArray[np.float64]:
    """Infinite where nothing closes, which is drawn as a gap, and at most the cap elsewhere."""
    return np.where(np.isnan(ttc_s), np.inf, np.minimum(ttc_s, cap_s))


def _gap(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Infinity draws a gap as NaN does, and compares equal to itself."""
    return np.where(np.isnan(values), np.inf, values)
