"""A run folder -> its operators as recordings, and a scenario that plays them back.

Whatever drove a priority arm, a trace holds the targets it gave, tick by tick. Written out as
recordings, with a scenario in which they stand in for the operators and in which every parameter
changes when it changed, they give the same trace again: bit by bit on a kinematic plant.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from workcell.errors import InputError
from workcell.motion.operators.recording_file import Samples, write
from workcell.motion.orientation import rotation_between
from workcell.scenario import Recording, Scenario
from workcell.trace.table import Trace, load

REPLAY_FILE = "replay.toml"
_MARGIN = 1.001
"""Caps of a replay are this much above what the recording needs, so that rounding does not break them."""


def write_replay(run: Path | str) -> list[Path]:
    """Write `operator_<arm>.csv` for every arm with an operator, and `replay.toml`, into a run folder.

    Returns:
        The paths written, replay.toml last.

    Raises:
        TraceError: the trace cannot be read.
        InputError: no arm of the run has an operator.
    """
    run = Path(run)
    trace = load(run)
    content: dict[str, Any] = copy.deepcopy(trace.metadata["settings"])
    written: list[Path] = []
    for arm in content["arm"]:
        if arm["operator"] is None:
            continue
        samples = samples_of(trace, arm["name"])
        written.append(write(run / f"operator_{arm['name']}.csv", samples))
        arm["operator"] = {
            "kind": "recording",
            "file": written[-1].name,
            **_caps(samples),
        }
    if not written:
        raise InputError("no arm of this run has an operator to record", file=run)
    content["change"] = _changes(trace)
    content["simulation"]["duration_s"] = max(1, len(trace)) * content["simulation"]["period_s"]
    replay = run / REPLAY_FILE
    replay.write_text(Scenario.model_validate(content).to_toml(), encoding="utf-8")
    return [*written, replay]


def write_takes(run: Path | str, takes: Sequence[tuple[int, int]]) -> list[Path]:
    """Write `take_<k>_<arm>.csv` for every take of a live run: a recording that begins at time 0.

    Args:
        run: Run folder.
        takes: First tick, and the one after the last, of each.

    Returns:
        The paths written; none for a take without a tick.
    """
    run = Path(run)
    if not takes:
        return []
    trace = load(run)
    arms = [arm["name"] for arm in trace.metadata["settings"]["arm"] if arm["operator"] is not None]
    written = []
    for arm in arms:
        whole = samples_of(trace, arm)
        for k, (first, end) in enumerate(takes, start=1):
            span = slice(first, end)
            if not len(whole.time_s[span]):
                continue
            part = Samples(
                whole.time_s[span] - whole.time_s[first],
                whole.position_m[span],
                whole.wxyz[span],
                None if whole.twist is None else whole.twist[span],
            )
            written.append(write(run / f"take_{k}_{arm}.csv", part))
    return written


def samples_of(trace: Trace, arm: str) -> Samples:
    """The targets one arm was given, a sample a tick."""
    twist = np.hstack([trace[f"{arm}.target_velocity_m_s"], trace[f"{arm}.target_turn_rad_s"]])
    return Samples(
        trace["time_s"], trace[f"{arm}.target_position_m"], trace[f"{arm}.target_wxyz"], twist
    )


def _caps(samples: Samples) -> dict[str, float]:
    """The caps of a recording's governor, wide enough to let this one through untouched."""
    defaults = {name: field.default for name, field in Recording.model_fields.items()}
    if len(samples.time_s) < 2 or samples.twist is None:
        return {}
    dt = float(np.median(np.diff(samples.time_s)))
    turns = np.array(
        [rotation_between(a, b) for a, b in zip(samples.wxyz[:-1], samples.wxyz[1:], strict=True)]
    )
    found: dict[str, float] = {}
    for speed, acceleration, way, rate in (
        (
            "max_speed_m_s",
            "max_acceleration_m_s2",
            np.diff(samples.position_m, axis=0),
            samples.twist[:, :3],
        ),
        ("max_turn_rad_s", "max_turn_rad_s2", turns, samples.twist[:, 3:]),
    ):
        found[speed] = float(np.linalg.norm(rate, axis=1).max())
        found[acceleration] = float(
            max(
                np.linalg.norm(np.diff(rate, axis=0), axis=1).max() / dt,
                np.linalg.norm(way - dt * rate[1:], axis=1).max() / dt**2,
            )
        )
    return {
        name: value * _MARGIN for name, value in found.items() if value * _MARGIN > defaults[name]
    }


def _changes(trace: Trace) -> list[dict[str, Any]]:
    """Every tick at which a parameter changed, with what it changed to."""
    t_min_s, criterion, entry = trace["t_min_s"], trace["criterion"], trace["entry"]
    return [
        {
            "time_s": float(trace["time_s"][k]),
            "t_min_s": float(t_min_s[k]),
            "criterion": str(criterion[k]),
            "entry": str(entry[k]) or None,  # once asked for, a side is not taken back
        }
        for k in range(1, len(trace))
        if any(values[k] != values[k - 1] for values in (t_min_s, criterion, entry))
    ]
