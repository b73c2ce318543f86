"""Metrics of a run against the `[expect]` of its scenario.

An expectation names a metric of the summary; a name that no summary can have, or a value that no such metric can
have, is refused before the run. A
metric that this run happens not to have is not held. A metric without a value (a pair never closed, an arm never halted)
holds no bound.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypedDict

from workcell.errors import did_you_mean, shown
from workcell.scenario import Bound, Scenario
from workcell.trace import metric_names


class Verdict(TypedDict):
    """One expectation, judged."""

    wanted: str
    measured: str
    held: bool


def faults(scenario: Scenario) -> list[str]:
    """A fault for every entry of `[expect]` that no summary of this scenario can meet."""
    arms = [arm.name for arm in scenario.arm]
    known = list(metric_names.names(arms))
    found = []
    for name, bound in scenario.expect.items():
        metric = metric_names.metric(name, arms)
        if metric is None:
            found.append(
                f"expect.{name}: is not a metric of this cell (docs/metrics.md lists them)"
                f"{did_you_mean(name, known)}"
            )
        elif wrong := _wrong_kind(metric, bound):
            found.append(f"expect.{name}: {wrong}")
    return found


def _wrong_kind(metric: metric_names.MetricName, bound: Bound) -> str | None:
    """What is wrong with a bound for this kind of metric, if anything is."""
    value, ranged = bound.equals, bound.min is not None or bound.max is not None
    if metric.verdict:
        fits, allowed = isinstance(value, bool) and not ranged, "is true or false"
    elif metric.unit:
        count = metric.unit == "1" and isinstance(value, int) and not isinstance(value, bool)
        fits, allowed = (
            value is None or count,
            "is a number; allowed are min, max, or the count it must be",
        )
    else:
        fits, allowed = (
            isinstance(value, str) and not ranged,
            "is a text; allowed is the text it must be",
        )
    return None if fits else f"{allowed}, not {shown(bound.model_dump(exclude_none=True))}"


def judge(metrics: Mapping[str, Any], expected: Mapping[str, Bound]) -> dict[str, Verdict]:
    """The verdict on every expectation, in the order of the scenario file."""
    return {name: _judge_one(metrics, name, bound) for name, bound in expected.items()}


def _judge_one(metrics: Mapping[str, Any], name: str, bound: Bound) -> Verdict:
    wanted = _wanted(bound)
    if name not in metrics:
        return Verdict(wanted=wanted, measured="no such metric in the summary", held=False)
    value = metrics[name]
    if bound.equals is not None:
        return Verdict(
            wanted=wanted,
            measured=_text(value),
            held=bool(value == bound.equals and type(value) is type(bound.equals)),
        )
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    held = (
        number
        and (bound.min is None or value >= bound.min)
        and (bound.max is None or value <= bound.max)
    )
    return Verdict(wanted=wanted, measured=_text(value), held=bool(held))


def _wanted(bound: Bound) -> str:
    if bound.equals is not None:
        return _text(bound.equals)
    if bound.min is not None and bound.max is not None:
        return f"{bound.min:g} to {bound.max:g}"
    return f"at least {bound.min:g}" if bound.min is not None else f"at most {bound.max:g}"


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.6g}" if isinstance(value, float) else "none" if value is None else str(value)
