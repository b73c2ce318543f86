"""What is left of a damaged run: the rows and the recording's chunks that are still whole.

In comes a run folder whose trace `load` refuses; out comes a new folder with a trace of the rows that
their checksums vouch for, and an account of what was lost: of a journal its intact batches, of a
parquet file its intact row groups. The index by which its rows are found has a copy beside it. A
recording is repaired by rerun's own tool, which keeps what comes before the damage; where the trace
could be read, a recording derived from it is better (`workcell.regression.restore`).
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from workcell.errors import TraceError
from workcell.trace.journal import JournalWriter, intact_batches
from workcell.trace.stored import INDEX_NAME, INTEGRITY_KEY, convert, with_index_of
from workcell.trace.table import JOURNAL_NAME, TRACE_NAME, load

_REPAIR_TIMEOUT_S = 120.0
"""Chosen as a hundred times what the largest recording so far took."""


@dataclass(frozen=True)
class Salvage:
    """What could be saved."""

    trace: Path | None
    """The new trace; None if no row was left."""
    rows: int
    """Rows it holds."""
    recording: Path | None
    """The repaired recording; None if there was none, or nothing in it."""
    losses: tuple[str, ...]
    """What was lost, and why, one sentence each; empty if nothing was damaged."""


def salvage(run: Path, out: Path, *, recording_name: str) -> Salvage:
    """Save what is intact of a run folder into another.

    Args:
        run: The damaged run folder; it is only read.
        out: Folder for what is left; another one than `run`.
        recording_name: Name of the recording in both.

    Raises:
        TraceError: there is neither trace nor recording, or `out` is `run`.
    """
    if out.resolve() == run.resolve():
        raise TraceError(f"{out}: what is left must go to another folder than the damaged run")
    sources = [run / name for name in (TRACE_NAME, JOURNAL_NAME) if (run / name).is_file()]
    recording = run / recording_name
    if not sources and not recording.is_file():
        raise TraceError(f"{run}: holds neither a trace nor a recording")
    out.mkdir(parents=True, exist_ok=True)
    trace, rows, losses = None, 0, []
    for source in sources:
        saved, lost = _save_rows(source, out)
        losses += lost
        if saved:
            trace, rows = out / TRACE_NAME, saved
            break
    repaired = None
    if recording.is_file():
        repaired, lost = _save_recording(recording, out / recording_name)
        losses += lost
    return Salvage(trace, rows, repaired, tuple(losses))


def _save_rows(source: Path, out: Path) -> tuple[int, list[str]]:
    """Write the intact rows of one file; how many there are, and what is missing."""
    losses: list[str] = []
    batches = (_of_journal if source.name == JOURNAL_NAME else _of_table)(source, losses)
    rows, writer, journal = 0, None, out / JOURNAL_NAME
    for batch in batches:
        writer = writer or JournalWriter(journal, batch.schema)
        writer.write(batch)
        rows += len(batch)
    if writer is None:
        return 0, losses
    writer.close()
    convert(journal, out / TRACE_NAME)
    journal.unlink()
    try:
        load(out)  # It must be a trace again, by the same checks as any other.
    except (TraceError, ValueError) as error:
        (out / TRACE_NAME).unlink()
        return 0, [*losses, f"{source}: its metadata cannot be read: {error}"]
    return rows, losses


def _of_journal(path: Path, losses: list[str]) -> Iterator[pa.RecordBatch]:
    try:
        yield from intact_batches(path, losses)
    except TraceError as error:
        losses.append(str(error))


def _of_table(path: Path, losses: list[str]) -> Iterator[pa.RecordBatch]:
    content = path.read_bytes()
    indexed = with_index_of(path.with_name(INDEX_NAME), path)
    if indexed is not None and indexed != content:
        losses.append(f"{path}: its index is damaged or cut off; the copy in {INDEX_NAME} is used")
        content = indexed
    try:
        file = pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True)
        # The schema is rebuilt from the file's, without the hash that covers the whole of it.
        entries = {
            k: v for k, v in (file.schema_arrow.metadata or {}).items() if k != INTEGRITY_KEY
        }
        schema = file.schema_arrow.with_metadata(entries)
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        losses.append(f"{path}: its index at the end cannot be read, and all rows with it: {error}")
        return
    with file:
        first = 0
        for group in range(file.num_row_groups):
            count = file.metadata.row_group(group).num_rows
            try:
                table = file.read_row_group(group).replace_schema_metadata(entries)
                table.validate(full=True)
            except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
                losses.append(f"{path}: rows {first} to {first + count - 1} are damaged: {error}")
            else:
                yield from table.cast(schema).to_batches()
            first += count
    if not losses:
        # Every group is whole, which leaves the metadata to explain why the file is refused.
        try:
            load(path)
        except TraceError as error:
            losses.append(f"{error}; every row is intact, so that it must be the metadata")


def _save_recording(source: Path, target: Path) -> tuple[Path | None, list[str]]:
    """Let rerun's tool take over what it can read of a recording."""
    # rerun takes half a second to import, which a salvage without a recording need not wait for.
    from rerun.chunk import RrdReader

    from workcell.trace.rerun_viewer import viewer_binary

    command = [viewer_binary(), "rrd", "merge", "--continue-on-error", "-o", target, source]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_REPAIR_TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        target.unlink(missing_ok=True)
        return None, [f"{source}: could not be repaired within {_REPAIR_TIMEOUT_S:g} s"]
    # The tool writes an empty recording where it could read nothing.
    if done.returncode or not target.is_file() or not RrdReader(str(target)).recordings():
        target.unlink(missing_ok=True)
        return None, [f"{source}: nothing in it can be read: {done.stderr.strip()[-300:]}"]
    verified = subprocess.run(
        [viewer_binary(), "rrd", "verify", source],
        capture_output=True, text=True, timeout=_REPAIR_TIMEOUT_S, check=False,
    )  # fmt: skip
    lost = (
        [f"{source}: is damaged: {verified.stderr.strip()[-300:]}"] if verified.returncode else []
    )
    return target, lost
