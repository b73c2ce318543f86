"""Two runs compared as a person would ask: later or earlier, nearer or farther, how many waits.

In come two traces; out come the parameters in which they differ and one sentence a quantity that is
not the same. Runs with different parameters, of different length, or of different scenarios can be
compared in words, as long as they have arms of the same names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from workcell.regression.settings import SettingChange, changes_of
from workcell.trace import metrics
from workcell.trace.readings import control_setting, period_s, scaled_down, spans
from workcell.trace.table import Trace

WAIT_S = 0.1
"""A stand or a strong slow-down for less is no wait: chosen as what an onlooker notices."""
WAIT_SCALE = 0.1
"""Below this part of its speed an arm waits; above it, it is slowed down."""


@dataclass(frozen=True)
class Figure:
    """One quantity of both runs."""

    name: str
    """What it is, for people."""
    run: float | None
    """What the run has; None where it has no such thing."""
    reference: float | None
    """What the reference has."""
    unit: str
    """Unit of both, as printed."""
    difference: str
    """The difference in words, `same` where there is none."""


@dataclass(frozen=True)
class Words:
    """A comparison for people."""

    settings: tuple[SettingChange, ...]
    """Parameters that differ."""
    figures: tuple[Figure, ...]
    """Every quantity that at least one of the runs has."""
    remarks: tuple[str, ...]
    """What else is to be said: arms that only one of the runs has, a run that did not end."""

    @property
    def same(self) -> bool:
        """Whether there is nothing to tell."""
        return not any(f.difference != "same" for f in self.figures) and not self.settings

    def headline(self) -> str:
        """All differences in one sentence."""
        told = [f"{f.name} {f.difference}" for f in self.figures if f.difference != "same"]
        return "; ".join(told) if told else "no difference that a person would notice"


@dataclass(frozen=True)
class _Kind:
    """How a difference is put into words."""

    more: str
    less: str
    factor: float
    unit: str
    least: float
    """Smaller differences, in the printed unit, are no difference."""


_LATER = _Kind("later", "earlier", 1.0, "s", 0.05)
_LONGER = _Kind("longer", "shorter", 1.0, "s", 0.05)
_FARTHER = _Kind("farther", "nearer", 1e3, "mm", 0.5)
_LARGER_MM = _Kind("larger", "smaller", 1e3, "mm", 0.5)
_FASTER = _Kind("faster", "slower", 1.0, "m/s", 0.005)
_MORE_S = _Kind("more", "less", 1.0, "s", 0.01)
_COUNT = _Kind("more", "fewer", 1.0, "", 0.5)


def compare_in_words(run: Trace, reference: Trace) -> Words:
    """Compare two runs by their metrics.

    Raises:
        TraceError: One of them has no rows.
    """
    mine, theirs = _measured(run), _measured(reference)
    arms = [arm for arm in reference.layout.arms if arm in run.layout.arms]
    figures = []
    for key, (name, kind) in _quantities(arms).items():
        a, b = mine.get(key), theirs.get(key)
        if a is not None or b is not None:
            figures.append(_figure(name, a, b, kind))
    remarks = []
    for who, one, other in (("run", run, reference), ("reference", reference, run)):
        only = [arm for arm in one.layout.arms if arm not in other.layout.arms]
        if only:
            remarks.append(f"only the {who} has the arm {', '.join(only)}")
    for who, values in (("run", mine), ("reference", theirs)):
        if values.get("contact"):
            remarks.append(f"the {who} has a contact")
        if values.get("completed") is False:
            remarks.append(f"the {who} did not get done")
    settings = changes_of(
        run.metadata.get("settings") or {}, reference.metadata.get("settings") or {}
    )
    return Words(tuple(settings), tuple(figures), tuple(remarks))


def waits(trace: Trace, arm: str) -> tuple[int, float]:
    """How often and how long, in seconds, an arm was slowed below `WAIT_SCALE` or stopped."""
    slow = trace[f"{arm}.scale"] < WAIT_SCALE
    slow &= scaled_down(trace, arm) | (trace[f"{arm}.mode"] == "halt")
    dt_s = period_s(trace)
    long = [len(span) * dt_s for span in spans(slow) if len(span) * dt_s >= WAIT_S]
    return len(long), float(sum(long))


def _measured(trace: Trace) -> Mapping[str, Any]:
    values = dict(metrics.summarise(trace))
    done = [values.get(f"{arm}.path_done_s") for arm in trace.layout.arms]
    values["done_s"] = None
    if values["completed"]:
        values["done_s"] = max((t for t in done if t is not None), default=None)
    values["t_min_s"] = control_setting(trace, "t_min_s")
    for arm in trace.layout.arms:
        values[f"{arm}.waits"], values[f"{arm}.waited_s"] = waits(trace, arm)
    return values


def _quantities(arms: list[str]) -> dict[str, tuple[str, _Kind]]:
    """Metric -> what it is called and how its difference is said, most telling first."""
    cell: dict[str, tuple[str, _Kind]] = {
        "done_s": ("done", _LATER),
        "smallest_distance_apart_m": ("smallest distance", _FARTHER),
        "smallest_check_distance_m": ("final check's distance", _FARTHER),
        "smallest_ttc_s": ("smallest time to collision", _LONGER),
        "deliveries": ("deliveries", _COUNT),
        "duration_s": ("run", _LONGER),
    }
    of_arm: dict[str, tuple[str, _Kind]] = {
        "waits": ("waits", _COUNT),
        "waited_s": ("time waited", _MORE_S),
        "impasse_attempts": ("impasse attempts", _COUNT),
        "peak_tool_speed_m_s": ("fastest", _FASTER),
        "max_tool_error_m": ("largest tool error", _LARGER_MM),
        "elbow_travel_m": ("elbow travel", _LARGER_MM),
    }
    return cell | {
        f"{arm}.{key}": (f"{arm}: {name}", kind)
        for arm in arms
        for key, (name, kind) in of_arm.items()
    }


def _figure(name: str, run: Any, reference: Any, kind: _Kind) -> Figure:
    scaled: Callable[[Any], float | None] = lambda x: None if x is None else kind.factor * float(x)  # noqa: E731
    a, b = scaled(run), scaled(reference)
    if a is None or b is None:
        difference = "only in the reference" if a is None else "only in the run"
    elif abs(a - b) < kind.least:
        difference = "same"
    else:
        amount = f"{abs(a - b):.3g}"
        text = f"{amount} {kind.unit}".strip()
        difference = f"{text} {kind.more if a > b else kind.less}"
    return Figure(name, a, b, kind.unit, difference)
