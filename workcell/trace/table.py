"""A trace read back: columns as arrays, verified before anything is believed.

In comes a run folder, a parquet file or a journal; out comes a `Trace`, whose columns are those of
`workcell.signals`. The journal vouches for itself batch by batch, the parquet file by checksums of
its pages and a hash over rows and metadata. `workcell.trace.writer` writes what is read here.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from workcell.errors import TraceError
from workcell.signals import SCHEMA_VERSION, Layout, columns
from workcell.trace.digest import TableDigest
from workcell.trace.journal import JournalReader
from workcell.trace.stored import INTEGRITY_KEY, StoredTable, pieces_of

TRACE_NAME = "trace.parquet"
JOURNAL_NAME = "trace.arrows"

LAYOUT_KEYS = ("schema_version", "arms", "joints", "nq", "nv", "pairs")
"""Entries of the file metadata that say what the columns are."""


@dataclass(frozen=True, repr=False)
class Trace:
    """A trace read back; `trace["time_s"]` is a column as a NumPy array.

    The rows of a parquet file stay in it, and a column is read whenever it is asked for.
    """

    rows: pa.Table | StoredTable
    """The rows, in memory or in their file."""
    source: Path
    """The file they were read from."""
    torn_bytes: int = 0
    """Bytes of an unfinished last batch that were dropped: more than 0 only after a kill."""

    def __repr__(self) -> str:
        return f"Trace({str(self.source)!r}, {len(self)} rows)"

    def __len__(self) -> int:
        return self.rows.num_rows

    def __getitem__(self, name: str) -> np.ndarray:
        """Column as an array: (T,) for a scalar, (T, n) for a vector.

        Null floats are NaN, null indices -1; strings come as an object array. The vectors over
        pairs of a long run fill gigabytes: `blocks` and `part` go without.
        """
        if pa.types.is_list(self._type(name)):
            return self.part(name)
        if isinstance(self.rows, StoredTable):
            return self._array(name, self.rows.column(name))
        return self._array(name, self.rows.column(name).combine_chunks())

    def blocks(
        self, name: str, ticks: NDArray[np.integer] | None = None
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Goes through a column in blocks of rows, so that it need not be held as a whole.

        Args:
            name: The column.
            ticks: (R,) rows that matter, rising; blocks without any of them are not read.

        Yields:
            First row and values, as `trace[name]` has them.
        """
        self._type(name)
        wanted = None if ticks is None else ticks.tolist()
        if isinstance(self.rows, StoredTable):
            pieces = self.rows.pieces(name, wanted)
        else:
            pieces = pieces_of(self.rows, name, wanted)
        for start, values in pieces:
            yield start, self._array(name, values.combine_chunks())

    def part(
        self,
        name: str,
        ticks: NDArray[np.integer] | None = None,
        entries: list[int] | None = None,
    ) -> np.ndarray:
        """Some rows and entries of a vector, with no more of it in memory than a block.

        Args:
            name: The column.
            ticks: (R,) rows to take, rising; None takes all.
            entries: Entries to take; None takes all.

        Returns:
            (R, m), equal to `trace[name][ticks][:, entries]`.
        """
        self._type(name)
        count = len(self) if ticks is None else len(ticks)
        if entries is None:
            taken = np.empty((count, self._width(name)))
        else:
            # In memory as NumPy lays out `[:, entries]`: sums over entries round alike.
            taken = np.empty((len(entries), count)).T
        for start, block in self.blocks(name, ticks):
            stop = start + len(block)
            if ticks is not None:
                first, last = np.searchsorted(ticks, [start, stop])
                block = block[ticks[first:last] - start]
                start, stop = first, last
            taken[start:stop] = block if entries is None else block[:, entries]
        return taken

    @property
    def table(self) -> pa.Table:
        """All rows in memory, as stored."""
        return self.rows.read() if isinstance(self.rows, StoredTable) else self.rows

    @property
    def column_names(self) -> list[str]:
        """Columns it has; one of an older workcell lacks those that have come since."""
        return self.rows.schema.names

    @cached_property
    def layout(self) -> Layout:
        """Arms, joints and pairs the trace was written for."""
        entries = self.metadata
        return Layout(
            arms=tuple(entries["arms"]),
            joints=tuple(entries["joints"]),
            nq=int(entries["nq"]),
            nv=int(entries["nv"]),
            pairs=tuple((first, second) for first, second in entries["pairs"]),
        )

    @cached_property
    def metadata(self) -> dict[str, Any]:
        """File metadata; entries that are JSON objects or lists are parsed, the rest is text."""
        return {
            key.decode(): json.loads(value) if value[:1] in (b"{", b"[") else value.decode()
            for key, value in (self.rows.schema.metadata or {}).items()
            if key != INTEGRITY_KEY
        }

    def digest(self) -> str:
        """SHA-256 over columns and rows, the same however the rows were batched.

        Metadata is left out: equal motions on two machines have equal digests.
        """
        if isinstance(self.rows, StoredTable):
            return self.rows.digest
        digest = TableDigest(self.rows.schema)
        for batch in self.rows.to_batches():
            digest.update(batch)
        return digest.hexdigest()

    def _type(self, name: str) -> pa.DataType:
        """Type of a column that must be there."""
        if name not in self.column_names:
            if name in {column.name for column in columns(self.layout)}:
                raise TraceError(f"{self.source}: is from before column {name!r} was logged")
            known = ", ".join(self.column_names)
            raise TraceError(f"{self.source}: no column {name!r}; there are {known}")
        return self.rows.schema.field(name).type

    def _width(self, name: str) -> int:
        return {column.name: column.width or 0 for column in columns(self.layout)}[name]

    def _array(self, name: str, array: pa.Array) -> np.ndarray:
        if pa.types.is_list(array.type):
            return self._vector(name, array)
        if pa.types.is_integer(array.type) and array.null_count:
            array = array.fill_null(-1)
        return array.to_numpy(zero_copy_only=False)

    def _vector(self, name: str, array: pa.ListArray) -> np.ndarray:
        width = self._width(name)
        values = array.flatten().to_numpy(zero_copy_only=False)
        if not array.null_count:
            return values.reshape(len(array), width)
        whole = np.full((len(array), width), np.nan)
        whole[array.is_valid().to_numpy(zero_copy_only=False)] = values.reshape(-1, width)
        return whole


def load(path: Path | str) -> Trace:
    """Reads a trace and verifies it.

    Args:
        path: A run folder, a parquet file or a journal. A folder without a parquet file, left by a
            run that was killed, gives the intact batches of its journal; an unfinished last batch
            is dropped with a warning and counted in `Trace.torn_bytes`.

    Raises:
        TraceError: There is no trace, it is damaged, or it was written by a newer version.
    """
    path = Path(path)
    if path.is_dir():
        found = [path / name for name in (TRACE_NAME, JOURNAL_NAME) if (path / name).is_file()]
        if not found:
            raise TraceError(f"{path}: holds neither {TRACE_NAME} nor {JOURNAL_NAME}")
        path = found[0]
    elif not path.is_file():
        raise TraceError(f"{path}: no such file or folder")
    if path.suffix == Path(JOURNAL_NAME).suffix:
        journal = JournalReader(path)
        trace = Trace(pa.Table.from_batches(journal, journal.schema), path, journal.torn_bytes)
        if trace.torn_bytes:
            warnings.warn(
                f"{path}: an unfinished last batch of {trace.torn_bytes} bytes was dropped",
                stacklevel=2,
            )
    else:
        trace = Trace(StoredTable(path), path)
    _check_schema(trace)
    return trace


def _check_schema(trace: Trace) -> None:
    entries = trace.rows.schema.metadata or {}
    missing = [key for key in LAYOUT_KEYS if key.encode() not in entries]
    if missing:
        raise TraceError(f"{trace.source}: metadata entries {', '.join(missing)} are missing")
    version = int(entries[b"schema_version"])
    if version > SCHEMA_VERSION:
        raise TraceError(
            f"{trace.source}: schema version {version} is newer than {SCHEMA_VERSION}, "
            "the newest this workcell reads"
        )
    known = {column.name for column in columns(trace.layout)}
    unknown = [name for name in trace.column_names if name not in known]
    if unknown:
        raise TraceError(
            f"{trace.source}: unknown columns {', '.join(unknown)}: it is from a newer workcell"
        )
    # A trace of an older workcell lacks the signals that have come since; asking for one says so.
