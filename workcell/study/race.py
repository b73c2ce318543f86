"""Strategies against each other on the same variations: `workcell race`.

Comes in: scenarios and names of strategies. Goes out: a sweep folder a scenario, and `race.md` with one table
a scenario and one over all of them: a row a strategy, with exact intervals for rates and medians for the rest. Every
strategy drives the same variations on the same drives and is judged by the same judge (outcome.py).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from workcell import plugins
from workcell.errors import InputError
from workcell.study import report, sweep
from workcell.study.report import Row, made
from workcell.study.statistics import rate

PAGE = "race.md"
SETTINGS = (
    "simulation.plant=kinematic",
    "simulation.period_s=0.02",
    "check.enabled=false",
)
"""What a race changes in every scenario: ideal drives, long ticks, and no second process that would end a run."""
DISTURBED = (
    "simulation.latency_ticks=2",
    "simulation.position_noise_rad=0.001",
    "simulation.velocity_noise_rad_s=0.01",
)
"""What `--disturbed` adds: two ticks of latency, noise of a poor encoder."""

COLUMNS: tuple[tuple[str, Callable[[list[Row]], str]], ...] = (
    ("done", lambda rows: _share(rows, lambda row: row["done"])),
    ("contact: support arm's part", lambda rows: _share(rows, _support_touched)),
    ("contact: others alone", lambda rows: _share(rows, _others_touched)),
    ("time, s", lambda rows: _median(rows, "done_s")),
    ("clearance, mm", lambda rows: _median(rows, "smallest_m", 1e3)),
    ("least clearance, mm", lambda rows: _extreme(rows, "smallest_m", np.nanmin, 1e3)),
    (
        "least own time to collision, s",
        lambda rows: _extreme(rows, "smallest_ttc_command_own_s", np.nanmin),
    ),
    ("off path, mm", lambda rows: _median(rows, "deviation_m", 1e3)),
    ("priority tool error, mm", lambda rows: _extreme(rows, "tool_error_m", np.nanmax, 1e3)),
    ("rms jerk, rad/s³", lambda rows: _median(rows, "jerk_rms_rad_s3")),
    ("peak jerk, rad/s³", lambda rows: _median(rows, "jerk_rad_s3")),
    ("faults", lambda rows: str(sum(row["status"] == "fault" for row in rows))),
)
"""Heads and cells, over the rows of one strategy."""


def race(
    scenarios: Sequence[str],
    strategies: Sequence[str],
    out: Path,
    executor: Executor,
    *,
    runs: int,
    seed: int,
    ahead: int,
    disturbed: bool = False,
    overrides: Sequence[str] = (),
    resume: bool = False,
    progress: Callable[[str, sweep.Progress], None] | None = None,
) -> Path:
    """Race strategies over scenarios.

    Args:
        scenarios: Names or paths.
        strategies: Names, at least two.
        out: Folder; a sweep a scenario goes into a folder of its own below it.
        executor: Who makes the runs.
        runs: Variations of each scenario.
        seed: Of all draws.
        ahead: Runs handed out at once.
        disturbed: Whether the controller's measurements are late and noisy (`DISTURBED`).
        overrides: Further settings of every scenario.
        resume: Go on with a race that was stopped.
        progress: Called with the scenario's name after every run.

    Returns:
        The page.

    Raises:
        InputError: A strategy is unknown, or there is only one.
    """
    if len(set(strategies)) < 2:
        raise InputError(f"--strategies {','.join(strategies)}: a race needs at least two")
    for name in strategies:
        plugins.find("strategies", name)
    settings = (*SETTINGS, *(DISTURBED if disturbed else ()), *overrides)
    found: dict[str, list[Row]] = {}
    for scenario in scenarios:
        name = Path(scenario).stem
        plan = sweep.plan(
            scenario,
            runs=runs,
            seed=seed,
            compare=(f"control.strategy={','.join(strategies)}",),
            overrides=settings,
        )
        told = None if progress is None else lambda now, name=name: progress(name, now)
        sweep.sweep(
            plan,
            out / name,
            executor,
            ahead=ahead,
            resume=resume and (out / name).exists(),
            progress=told,
        )
        found[name] = report.read(out / name)
    page = out / PAGE
    page.write_text("\n".join(_page(found, settings)) + "\n", encoding="utf-8")
    return page


def _page(found: dict[str, list[Row]], settings: Sequence[str]) -> Iterator[str]:
    yield "# Race"
    yield ""
    yield f"Every scenario with `{' '.join(settings)}`. Rates with 95 % Clopper-Pearson intervals; medians over the runs; least and largest over all of them."
    for name, rows in found.items():
        yield from ("", f"## {name}", "")
        yield from table(rows)
    if len(found) > 1:
        yield from ("", "## All", "")
        yield from table([row for rows in found.values() for row in rows])


def table(rows: list[Row]) -> Iterator[str]:
    """Lines of a Markdown table, a row a strategy."""
    yield "| strategy | " + " | ".join(head for head, _ in COLUMNS) + " |"
    yield "| --- |" + " --- |" * len(COLUMNS)
    for setting, of_one in report.by_setting(rows).items():
        cells = [cell(made(of_one)) for _, cell in COLUMNS]
        yield f"| `{setting.rpartition('=')[2]}` | " + " | ".join(cells) + " |"


def _support_touched(row: Row) -> bool:
    return row["contact_cause"] in ("support", "both")


def _others_touched(row: Row) -> bool:
    return row["contact_cause"] in ("priority", "none")


def _share(rows: list[Row], happened: Callable[[Row], bool]) -> str:
    return str(rate(sum(map(happened, rows)), len(rows))) if rows else "none"


def _numbers(rows: list[Row], column: str, factor: float) -> np.ndarray:
    return np.array([factor * row[column] for row in rows if row[column] is not None])


def _median(rows: list[Row], column: str, factor: float = 1.0) -> str:
    numbers = _numbers(rows, column, factor)
    return f"{np.median(numbers):.3g}" if len(numbers) else "none"


def _extreme(
    rows: list[Row], column: str, which: Callable[[np.ndarray], float], factor: float = 1.0
) -> str:
    numbers = _numbers(rows, column, factor)
    return f"{which(numbers):.3g}" if len(numbers) else "none"
