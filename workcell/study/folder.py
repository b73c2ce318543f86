"""The folder of a sweep: what was asked, what has come, and the table that is made of it.

sweep.json      what fixes the runs
runs.jsonl      the journal, a line a run, while the sweep lasts and for `--resume`
runs.parquet    one row a run, in order
failures/       run folders of failed runs
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from workcell.errors import InputError
from workcell.files import read_object, read_text
from workcell.study import outcome

PLAN_FILE = "sweep.json"
JOURNAL_FILE = "runs.jsonl"
TABLE_FILE = "runs.parquet"
FAILURES_FOLDER = "failures"

ASKED = ("scenario", "set", "compare", "seed", "content_sha256", "vary", "versions")
"""Keys of what fixes the runs."""

Run = tuple[int, str]
"""Number and setting of a run."""


def open_folder(asked: Mapping[str, Any], runs: int, out: Path, resume: bool) -> set[Run]:
    """Make or reopen the folder of a sweep.

    Args:
        asked: What fixes the runs.
        runs: Variations under each setting.
        out: The folder.
        resume: Whether to go on with what is in it.

    Returns:
        The runs it already holds; one that its worker did not survive, or a defect broke off, is made again.

    Raises:
        InputError: the folder holds a sweep that is not to be gone on with, another one, or a damaged one.
    """
    if (out / PLAN_FILE).is_file():
        if not resume:
            raise InputError(
                f"--out {out}: holds a sweep; say --resume to go on with it, or name another folder"
            )
        there = read_asked(out)
        differing = [key for key, value in asked.items() if there[key] != value]
        if differing:
            raise InputError(
                f"--resume: the sweep in {out} differs from what is asked now in {', '.join(differing)}"
            )
        _drop_torn_line(out / JOURNAL_FILE)
    else:
        out.mkdir(parents=True, exist_ok=True)
        (out / PLAN_FILE).write_text(json.dumps(asked, indent=2) + "\n", encoding="utf-8")
        (out / JOURNAL_FILE).write_text("", encoding="utf-8")
    return {
        (row["run"], row["setting"])
        for row in read_journal(out)
        if row["run"] < runs and row["status"] not in ("died", "error")
    }


def read_asked(out: Path) -> dict[str, Any]:
    """What fixes the runs of a sweep's folder.

    Raises:
        InputError: the folder holds no sweep, or a damaged one.
    """
    path = out / PLAN_FILE
    try:
        asked = read_object(path)
    except (OSError, ValueError) as error:
        raise InputError(f"holds no sweep: {error}", file=path) from error
    missing = [key for key in ASKED if key not in asked]
    if missing:
        raise InputError(f"is damaged: {', '.join(missing)} missing", file=path)
    return asked


def read_journal(out: Path) -> list[dict[str, Any]]:
    """Whole lines of the journal, the last of each run.

    Raises:
        InputError: there is no journal, or a line of it is damaged.
    """
    path = out / JOURNAL_FILE
    try:
        lines = read_text(path).splitlines(keepends=True)
    except (OSError, ValueError) as error:
        raise InputError(f"the journal of the sweep cannot be read: {error}", file=path) from error
    latest: dict[Run, dict[str, Any]] = {}
    for number, line in enumerate(lines, 1):
        if line.endswith("\n"):
            row = _row(line)
            if row is None:
                raise InputError(
                    f"line {number} is damaged; take it out, and its run is made again", file=path
                )
            latest[row["run"], row["setting"]] = row
    return list(latest.values())


def write_table(out: Path) -> Path:
    """runs.parquet from the journal, rows in the order of runs and settings; a torn last line is left out.

    Raises:
        InputError: what is in the folder is damaged.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    asked = read_asked(out)
    order = {setting: place for place, setting in enumerate(asked["content_sha256"])}
    rows = read_journal(out)
    strange = sorted({row["setting"] for row in rows} - set(order))
    if strange:
        raise InputError(
            f"names settings that {PLAN_FILE} has not: {strange}", file=out / JOURNAL_FILE
        )
    rows.sort(key=lambda row: (row["run"], order[row["setting"]]))
    columns: dict[str, Any] = {name: [row[name] for row in rows] for name in outcome.COLUMNS}
    for key in asked["vary"]:
        values = [row["values"].get(key) for row in rows]
        # A choice may mix types, which a column cannot: those are kept as text.
        plain = len({type(v) for v in values}) == 1
        columns[f"vary.{key}"] = values if plain else [json.dumps(v) for v in values]
    pq.write_table(pa.table(columns), out / TABLE_FILE)
    return out / TABLE_FILE


def kept(out: Path) -> list[Path]:
    """Run folders of failed runs."""
    return sorted((out / FAILURES_FOLDER).glob("*/"))


def keep_failure(out: Path, report: outcome.Report) -> None:
    """Keep the run folder of a failed run, with the command that makes it again."""
    folder = out / FAILURES_FOLDER / folder_name(report.outcome.run, report.outcome.setting)
    for name, content in report.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    command = f"workcell run {folder / 'scenario.toml'} --out {folder.name}_again"
    (folder / "reproduce.txt").write_text(command + "\n", encoding="utf-8")


def folder_name(run: int, setting: str) -> str:
    """Name of the folder of one run among those of a sweep."""
    label = "".join(c if c.isalnum() or c in "._-" else "_" for c in setting.replace("=", "-"))
    return f"{run:05d}{'_' + label if label else ''}"


def _row(line: str) -> dict[str, Any] | None:
    """A line of the journal, if it is one of this version's."""
    try:
        row = json.loads(line)
    except ValueError:
        return None
    whole = isinstance(row, dict) and {*outcome.COLUMNS, "values"} <= set(row)
    usable = whole and isinstance(row["run"], int) and isinstance(row["setting"], str)
    return row if usable and isinstance(row["values"], dict) else None


def _drop_torn_line(journal: Path) -> None:
    """Cut off what a kill left of a last line, so that the next one does not continue it."""
    if journal.is_file():
        text = journal.read_bytes()
        journal.write_bytes(text[: text.rfind(b"\n") + 1])
