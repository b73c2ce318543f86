"""What a sweep has shown: a page of tables for people, from the table of its runs.

Comes in: runs.parquet. Goes out: summary.md with, for every setting, how often things happened
(exact intervals, statistics.py) and how large they were (median, and the 5th to 95th percentile of the runs);
and, where several settings were tried on the same variations, their paired differences.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.files import require_file
from workcell.study.outcome import COLUMNS
from workcell.study.statistics import paired, paired_events, percent, rate

SUMMARY_FILE = "summary.md"

Row = dict[str, Any]


@dataclass(frozen=True)
class Event:
    """Something a run shows or does not."""

    name: str
    """For people."""
    happened: Callable[[Row], bool]
    """Whether a row shows it."""


@dataclass(frozen=True)
class Quantity:
    """A column of numbers."""

    column: str
    """Its name in the table."""
    name: str
    """For people, with its unit."""
    factor: float = 1.0
    """From the column's unit to the one shown."""


EVENTS = (
    Event("success", lambda row: row["success"]),
    Event("all jobs done", lambda row: row["done"]),
    Event(
        "contact, support arm had a part", lambda row: row["contact_cause"] in ("support", "both")
    ),
    Event("contact by the priority arm alone", lambda row: row["contact_cause"] == "priority"),
    Event("contact by nobody's motion", lambda row: row["contact_cause"] == "none"),
    Event("halt of the final check", lambda row: row["halted"]),
    Event("nearer than d_min, meeting tools apart", lambda row: row["below_d_min"]),
    Event("support arms' commands short of t_min", lambda row: bool(row["short_ticks"])),
    Event("impasse", lambda row: row["impasse"]),
    Event("fault of the controller", lambda row: row["status"] == "fault"),
)
QUANTITIES = (
    Quantity("done_s", "time to all jobs done, s"),
    Quantity("smallest_m", "smallest distance, mm", 1e3),
    Quantity("smallest_support_m", "smallest distance a support arm closed, mm", 1e3),
    Quantity("smallest_ttc_s", "smallest measured time to collision, s"),
    Quantity("smallest_ttc_command_own_s", "smallest commanded time to collision, s"),
    Quantity("tool_error_m", "largest tool error of a priority arm, mm", 1e3),
    Quantity("deviation_m", "largest deviation of a support arm's tool, mm", 1e3),
    Quantity("jerk_rms_rad_s3", "rms joint jerk of the support arms, rad/s³"),
    Quantity("jerk_rad_s3", "largest joint jerk of a support arm, rad/s³"),
)


def read(out: Path) -> list[Row]:
    """The rows of a sweep's folder.

    Raises:
        InputError: its table is missing or damaged.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    from workcell.study.folder import TABLE_FILE

    path = out / TABLE_FILE
    try:
        require_file(path)
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"the table of the sweep cannot be read: {error}", file=path) from error
    missing = [name for name in COLUMNS if name not in table.column_names]
    if missing:
        raise InputError(f"is no table of a sweep: {', '.join(missing)} missing", file=path)
    return table.to_pylist()


def by_setting(rows: list[Row]) -> dict[str, list[Row]]:
    """Rows by setting, in the order in which the settings were first tried."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row["setting"], []).append(row)
    return found


def made(rows: list[Row]) -> list[Row]:
    """The rows of runs that were made: started, and not broken off by what is no part of them."""
    return [row for row in rows if row["status"] in ("ran", "fault")]


def values(rows: list[Row], quantity: Quantity) -> NDArray[np.float64]:
    """(n,) a quantity as shown; NaN where a run has none."""
    raw = [np.nan if row[quantity.column] is None else row[quantity.column] for row in rows]
    return quantity.factor * np.array(raw, dtype=float)


def conclude(out: Path, command: str) -> Path:
    """Write summary.md and the figures of a sweep's folder; returns the path of the former.

    Args:
        out: The folder, with its table.
        command: What made it.
    """
    from workcell.study import figures

    rows = read(out)
    text = "\n".join(_page(rows, command)) + "\n"
    (out / SUMMARY_FILE).write_text(text, encoding="utf-8")
    if rows:
        figures.draw(rows, out / "figures")
    return out / SUMMARY_FILE


def all_succeeded(out: Path) -> bool:
    """Whether every run that was made is a success, and none was lost."""
    rows = read(out)
    return bool(made(rows)) and all(row["success"] for row in rows if row["status"] != "refused")


def command_line(name: str, scenario: str, options: dict[str, Any]) -> str:
    """The command with these options, as typed."""
    words = ["workcell", name, scenario]
    for key, value in options.items():
        for one in value if isinstance(value, (list, tuple)) else [value]:
            words += [f"--{key}", str(one)]
    return shlex.join(words)


def _page(rows: list[Row], command: str) -> Iterator[str]:
    settings = by_setting(rows)
    yield "# Sweep"
    yield ""
    yield f"    {command}"
    yield ""
    yield "Rates with 95 % Clopper-Pearson intervals, one-sided where nothing or everything happened."
    yield ""
    yield from _table(
        "rate",
        settings,
        [
            (
                event.name,
                [
                    str(rate(sum(map(event.happened, made(r))), len(made(r))))
                    for r in settings.values()
                ],
            )
            for event in EVENTS
        ]
        + [
            (name, [str(sum(row["status"] == status for row in r)) for r in settings.values()])
            for status, name in (
                ("refused", "refused before the start"),
                ("died", "lost with a worker"),
                ("error", "broken off by a defect"),
            )
            if any(row["status"] == status for row in rows)
        ],
    )
    yield ""
    yield "Median over the runs (5th to 95th percentile)."
    yield ""
    yield from _table(
        "quantity",
        settings,
        [(q.name, [_spread(values(made(r), q)) for r in settings.values()]) for q in QUANTITIES],
    )
    if len(settings) > 1:
        yield ""
        yield from _differences(settings)
    yield ""
    yield _cost(rows)


def _differences(settings: dict[str, list[Row]]) -> Iterator[str]:
    """Every setting against the first, variation by variation."""
    first, *others = settings
    base = {row["run"]: row for row in made(settings[first])}
    yield f"Paired differences to `{first}`: mean over the variations both could run, with its 95 % interval;"
    yield "an asterisk where it leaves out zero. No correction for reading many of them at once."
    yield ""
    pairs = {
        name: [(base[row["run"]], row) for row in made(settings[name]) if row["run"] in base]
        for name in others
    }
    lines = [
        (
            f"{event.name}, percentage points",
            [
                paired_events(
                    [event.happened(a) for a, _ in pairs[name]],
                    [event.happened(b) for _, b in pairs[name]],
                ).text(100.0)
                for name in others
            ],
        )
        for event in EVENTS
    ] + [
        (
            q.name,
            [
                paired(
                    values([a for a, _ in pairs[name]], q), values([b for _, b in pairs[name]], q)
                ).text()
                for name in others
            ],
        )
        for q in QUANTITIES
    ]
    yield from _table("difference", {name: settings[name] for name in others}, lines)


def _table(
    head: str, settings: dict[str, list[Row]], lines: list[tuple[str, list[str]]]
) -> Iterator[str]:
    names = [name or "as in the file" for name in settings]
    yield f"| {head} | " + " | ".join(names) + " |"
    yield "| --- |" + " --- |" * len(names)
    for name, cells in lines:
        yield f"| {name} | " + " | ".join(cells) + " |"


def _spread(shown: NDArray[np.float64]) -> str:
    shown = shown[np.isfinite(shown)]
    if not len(shown):
        return "none"
    low, middle, high = np.percentile(shown, [5, 50, 95])
    return f"{middle:.4g} ({low:.4g} to {high:.4g})"


def _cost(rows: list[Row]) -> str:
    simulated_s, wall_s = (sum(row[key] for row in rows) for key in ("simulated_s", "wall_s"))
    peak_mb = max((row["peak_memory_mb"] for row in rows), default=0.0)
    pace = f"{simulated_s / wall_s:.3g}" if wall_s else "no"
    lost = sum(row["status"] == "refused" for row in rows)
    share = f"; {percent(lost / len(rows))} of the variations drawn were refused" if lost else ""
    return (
        f"{len(rows)} runs, {simulated_s:.0f} s simulated at {pace} simulated seconds a second and worker; "
        f"largest memory of a worker {peak_mb:.0f} MB{share}."
    )
