"""Metrics of a run against the `[expect]` of its scenario.

An expectation names a metric of the summary; one that names none is not held, so that a typing
error cannot pass for a success. A metric without a value (a pair never closed, an arm never halted)
holds no bound.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypedDict

from workcell.scenario import Bound


class Verdict(TypedDict):
    """One expectation, judged."""

    wanted: str
    measured: str
    held: bool


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
