"""Runs with a hostile hand, judged: the promise held against operators from outside, `python -m workcell.study.hostile`.

Seeded variations of several scenarios; in every one the surgeon's operator is replaced by one that reaches, flicks,
trembles and drops out as `scenarios/hostile_hand.toml` describes. Each run is judged by `workcell.judge`; the
table says how often a support arm touched, closed a pair below 0.99 t_min or exceeded the cap.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import asdict
from pathlib import Path
from typing import Any

from workcell import scenario as scenario_file
from workcell.errors import InputError
from workcell.study import outcome, workers
from workcell.study.outcome import Outcome, Report
from workcell.study.statistics import rate
from workcell.study.vary import Variations

SCENARIOS = ("hostile_hand", "handover", "surgeon_sweeps", "busy_human", "give_instrument")
SOURCE = "hostile_hand"
"""Whose operator and variations of it all scenarios get."""
JOURNAL_FILE, TABLE_FILE = "runs.jsonl", "summary.md"


def variations(name: str, overrides: tuple[str, ...] = ()) -> Variations:
    """A shipped scenario with the hostile hand in the place of its surgeon's operator, and that hand's variations.

    Raises:
        InputError: the scenario has no arm that the hostile hand could drive.
    """
    source, target = scenario_file.load(SOURCE), scenario_file.load(name, overrides)
    hand = next(arm for arm in source.arm if arm.operator is not None)
    content = target.model_dump(mode="json")
    driven = [arm for arm in content["arm"] if arm["name"] == hand.name]
    if not driven:
        raise InputError(f"{name}: has no arm {hand.name!r} for the hostile hand to drive")
    content["vary"] = source.model_dump(mode="json")["vary"] if name != SOURCE else content["vary"]
    if name != SOURCE:
        driven[0]["operator"] = hand.model_dump(mode="json")["operator"]
        content["vary"] = {
            key: law
            for key, law in content["vary"].items()
            if key.startswith((f"arm.{hand.name}.operator.", "simulation.seed"))
        }
    content["expect"] = {}
    return Variations(scenario_file.validate(content, Path(target.file)))


def runs(
    names: tuple[str, ...], count: int, seed: int, overrides: tuple[str, ...]
) -> Iterator[tuple[str, int, dict[str, Any], scenario_file.Scenario | None, str]]:
    """`count` runs in all, dealt out over the scenarios: name, number, values, and the scenario or why there is none."""
    spaces = {name: variations(name, overrides) for name in names}
    for k in range(count):
        name = names[k % len(names)]
        values = spaces[name].draw(seed, k // len(names))
        try:
            yield name, k // len(names), values, spaces[name].scenario(values), ""
        except InputError as error:
            yield name, k // len(names), values, None, "; ".join(error.faults)


def make(
    names: tuple[str, ...],
    count: int,
    seed: int,
    overrides: tuple[str, ...],
    out: Path,
    processes: int | None,
    deadline_s: float = float("inf"),
) -> Path:
    """Make and judge the runs; returns the page with the table. A row is written as each run ends."""
    out.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    with (
        workers.pool(processes, None) as (executor, width),
        (out / JOURNAL_FILE).open("w", encoding="utf-8") as journal,
    ):
        under_way: dict[Future, tuple[str, int, dict[str, Any]]] = {}
        for name, k, values, scenario, fault in runs(names, count, seed, overrides):
            if time.monotonic() - started > deadline_s:
                break
            if scenario is None:
                _write(journal, name, Outcome(k, name, "refused", reason=fault), values)
                continue
            future = executor.submit(outcome.perform, k, name, scenario, False)
            under_way[future] = (name, k, values)
            if len(under_way) >= 2 * width:
                _collect(under_way, journal)
        while under_way:
            _collect(under_way, journal)
    page = out / TABLE_FILE
    page.write_text(table(out / JOURNAL_FILE), encoding="utf-8")
    return page


def _collect(under_way: dict[Future, tuple[str, int, dict[str, Any]]], journal: Any) -> None:
    ready, _ = wait(under_way, return_when=FIRST_COMPLETED)
    for future in ready:
        name, k, values = under_way.pop(future)
        error = future.exception()
        if error is None:
            report: Report = future.result()
            _write(journal, name, report.outcome, values)
        else:
            status = "error" if workers.death(error) is None else "died"
            _write(journal, name, Outcome(k, name, status, reason=str(error)), values)


def _write(journal: Any, name: str, row: Outcome, values: dict[str, Any]) -> None:
    line = {"scenario": name, **asdict(row), "values": values}
    journal.write(json.dumps(line, allow_nan=False) + "\n")
    journal.flush()


def table(journal: Path) -> str:
    """The rows of a journal as a page: by scenario and overall, with exact intervals."""
    rows = [json.loads(line) for line in journal.read_text(encoding="utf-8").splitlines()]
    names = list(dict.fromkeys(row["scenario"] for row in rows))
    lines = [
        "| scenario | runs | contact, support arm had a part | contact by the priority arm alone | runs with own times below 0.99 t_min | their ticks | largest tool error of the surgeon, mm | refused | failed |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name in [*names, "all"]:
        mine = [row for row in rows if name in (row["scenario"], "all")]
        ran = [row for row in mine if row["status"] in ("ran", "fault")]
        caused = sum(row["contact_cause"] in ("support", "both") for row in ran)
        theirs = sum(row["contact_cause"] == "priority" for row in ran)
        short = [row["short_ticks"] or 0 for row in ran]
        error = max((row["tool_error_m"] or 0.0 for row in ran), default=0.0)
        refused = sum(row["status"] == "refused" for row in mine)
        failed = len(mine) - len(ran) - refused
        lines.append(
            f"| {name} | {len(ran)} | {rate(caused, len(ran))} | {theirs} | {sum(x > 0 for x in short)} | {sum(short)} | {1e3 * error:.2f} | {refused} | {failed} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Command line of the study."""
    parser = argparse.ArgumentParser(prog="workcell.study.hostile", description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scenarios", default=",".join(SCENARIOS))
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--deadline-s", type=float, default=float("inf"))
    parser.add_argument("--out", type=Path, default=Path("runs/hostile"))
    asked = parser.parse_args()
    overrides = tuple(asked.set) or (
        "simulation.plant=kinematic",
        "simulation.period_s=0.01",
        "check.enabled=false",
    )
    page = make(
        tuple(asked.scenarios.split(",")),
        asked.runs,
        asked.seed,
        overrides,
        asked.out,
        asked.workers,
        asked.deadline_s,
    )
    print(page.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
