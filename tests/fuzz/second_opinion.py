"""Does a run folder say what its judge says? Asked of every run of the campaign.

The judge works from the recorded states and the scene file alone. A summary must not say 'held' of a run in which it
sees a contact that nobody expected, nor tell another number than the judge's.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from workcell.judge import judge_run
from workcell.run import CONTACT_METRICS
from workcell.trace.table import load

RELATIVE = 1e-9
"""Numbers of one computation that are this near are the same."""


def second_opinion(folder: Path) -> list[str]:
    """What of a run's summary the judge calls false; empty if nothing is."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    verdict = judge_run(folder)
    said, judged = summary["metrics"], verdict.metrics()
    faults = [
        f"the summary says {name} = {said[name]}, the judge {value}"
        for name, value in judged.items()
        if not _same(said[name], value)
    ]
    expected = any(name in summary["expectations"] for name in CONTACT_METRICS)
    if summary["held"]:
        if verdict.contacts and not expected:
            pair = " and ".join(verdict.contacts[0].pair)
            faults.append(f"held, but the judge sees a contact of {pair}")
        faults += [
            f"held, but {name} was expected to be {verdict['wanted']} and the judge says {judged[name]}"
            for name, verdict in summary["expectations"].items()
            if name in judged and not verdict["held"]
        ]
        faults += _faults_of_check(folder, said)
    return faults


def _faults_of_check(folder: Path, said: dict[str, Any]) -> list[str]:
    """The final check is a third opinion: it measures the same solids while the run goes on."""
    nearest = load(folder)["check_distance_m"]
    if (nearest <= 0.0).any() and not said["contact"]:
        return ["held without a contact, but the final check has measured 0 m or less"]
    return []


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, (int, float)):
        return math.isclose(one, other, rel_tol=RELATIVE, abs_tol=RELATIVE)
    return one == other
