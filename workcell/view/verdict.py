"""The verdict of a run as a page of text, for viewers and reports.

In comes a summary (`summary.json`); out come Markdown lines: what was expected and came out, what
stopped the run, and its few main figures.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MAIN_METRICS = (
    ("duration_s", "s"),
    ("smallest_distance_m", "m"),
    ("smallest_ttc_s", "s"),
    ("smallest_check_distance_m", "m"),
)
"""Metrics that are told of every run, with their units."""


def headline(summary: Mapping[str, Any]) -> str:
    """The verdict in one sentence."""
    metrics = summary["metrics"]
    if metrics.get("fault"):
        return f"stopped: {metrics['fault']}"
    if summary["held"]:
        return "all expectations held"
    broken = [name for name, verdict in summary["expectations"].items() if not verdict["held"]]
    if broken:
        return f"not as expected: {', '.join(broken)}"
    if metrics.get("interrupted"):
        return "interrupted by a person"
    halt = summary.get("final_check", {}).get("halt")
    return f"stopped by the final check: {halt['reason']}" if halt else "not as expected"


def markdown(summary: Mapping[str, Any]) -> str:
    """The verdict as a page."""
    lines = [f"### {summary['scenario']}: {headline(summary)}", ""]
    why = summary.get("why")
    if why:
        lines += [*([why] if isinstance(why, str) else map(str, why)), ""]
    if summary["expectations"]:
        lines += ["| expectation | wanted | measured | held |", "|---|---|---|---|"]
        lines += [
            f"| {name} | {v['wanted']} | {v['measured']} | {'yes' if v['held'] else '**NO**'} |"
            for name, v in summary["expectations"].items()
        ]
        lines.append("")
    for name, unit in MAIN_METRICS:
        value = summary["metrics"].get(name)
        if value is not None:
            lines.append(f"- {name.removesuffix('_' + unit).replace('_', ' ')}: {value:.4g} {unit}")
    return "\n".join(lines)
