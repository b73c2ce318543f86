"""The trace as a table: one row a control tick, safe against a kill, checked against damage.

In comes a row a tick; out come `trace.parquet` and, while the run lasts, the journal
`trace.arrows` (an Arrow stream of small batches, each handed to the operating system at once, so
that a kill costs at most the batch being filled). Columns and their types follow from
`workcell.signals`. What is read back is verified: the journal by itself, the parquet file by
checksums of its pages and a hash of rows and metadata.
"""

from __future__ import annotations

import json
import os
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter, itemgetter
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from workcell.errors import TraceError
from workcell.signals import SCHEMA_VERSION, Column, Layout, columns
from workcell.trace.digest import TableDigest
from workcell.trace.journal import JournalReader, JournalWriter
from workcell.trace.stored import INTEGRITY_KEY, StoredTable, integrity, pieces_of

TRACE_NAME = "trace.parquet"
JOURNAL_NAME = "trace.arrows"

_LAYOUT_KEYS = ("schema_version", "arms", "joints", "nq", "nv", "pairs")

FLUSH_S = 0.5
"""Simulated time of rows that are handed on together; what a kill may cost."""
_ROW_GROUP_ROWS = 8192
"""Rows a parquet row group holds, and a block of a column: chosen so that a conversion needs some ten
megabytes whatever the length of the run, while columns stay long enough to compress."""

_LIST = pa.list_(pa.field("element", pa.float64(), nullable=False))

_Row = Mapping[str, object] | Any
_Values = tuple[tuple[Any, ...], tuple[Any, ...]]


class TraceWriter:
    """Writes one trace, a row a tick.

    Args:
        folder: Run folder, made if it is missing. A trace already in it is removed, so that a
            folder never mixes two runs.
        layout: Arms, joints and pairs of the scene.
        metadata: Further entries of the file metadata (versions, scenario hash, settings, ...).
        period_s: Length of a control tick.
        flush_s: Simulated time after which rows go to the journal; what a kill may cost.
        flush_wall_s: The same in wall-clock time, for runs that wait for the clock; None never
            looks at one.

    Raises:
        TraceError: Metadata that the layout already sets, or a journal that cannot be written.
    """

    def __init__(
        self,
        folder: Path | str,
        layout: Layout,
        metadata: Mapping[str, str],
        period_s: float,
        *,
        flush_s: float = FLUSH_S,
        flush_wall_s: float | None = None,
    ):
        self.path = Path(folder) / TRACE_NAME
        self.journal = Path(folder) / JOURNAL_NAME
        self._columns = columns(layout)
        self._arms = layout.arms
        self._schema = schema(layout, metadata)
        self._capacity = max(1, int(flush_s / period_s))
        self._flush_wall_s = flush_wall_s

        vectors = [c for c in self._columns if c.width is not None]
        self._vector_names = tuple(c.name for c in vectors)
        self._widths = tuple(c.width for c in vectors)
        self._nullable_vectors = [
            (k, c.name, np.zeros(c.width or 0)) for k, c in enumerate(vectors) if c.signal.nullable
        ]
        self._block = np.zeros((self._capacity, sum(c.width or 0 for c in vectors)))
        self._null = np.zeros((self._capacity, len(vectors)), dtype=bool)
        self._scalars: list[tuple[Any, ...]] = []
        self._take: Callable[[_Row], _Values] | None = None

        Path(folder).mkdir(parents=True, exist_ok=True)
        self.path.unlink(missing_ok=True)
        self._rows_out = JournalWriter(self.journal, self._schema)
        self._flushed_at_s = time.monotonic() if flush_wall_s is not None else 0.0
        self._closed = False
        # A batch without rows puts the schema into the journal, and has Arrow load what it needs
        # for its first conversion (90 ms) before there is a clock to keep.
        self._rows_out.write(self._batch())

    def append(self, row: _Row) -> None:
        """Adds one row.

        Args:
            row: A mapping from column name to value, or an object with an attribute for every
                signal of the cell and `arms`, a mapping from arm name to an object with an
                attribute for every signal of an arm. Vectors are copied. None is null.

        Raises:
            TraceError: A column is missing, unknown, of the wrong length or type.
        """
        if self._closed:
            raise TraceError(f"{self.path}: a row was added after the trace was closed")
        try:
            if self._take is None:
                self._take = self._bind(row)
            scalars, vectors = self._take(row)
        except (KeyError, AttributeError) as error:
            raise TraceError(f"{self.path}: the row has no column {error}") from error
        index = len(self._scalars)
        if self._nullable_vectors:
            filled = list(vectors)
            for k, _, blank in self._nullable_vectors:
                if filled[k] is None:
                    filled[k] = blank
                    self._null[index, k] = True
            vectors = filled
        try:
            if tuple(map(len, vectors)) != self._widths:
                raise ValueError("wrong length")
            np.concatenate(vectors, out=self._block[index])
        except (TypeError, ValueError) as error:
            raise TraceError(f"{self.path}: {self._vector_fault(vectors)}") from error
        self._scalars.append(scalars)
        if index + 1 == self._capacity or (
            self._flush_wall_s is not None
            and time.monotonic() - self._flushed_at_s >= self._flush_wall_s
        ):
            self.flush()

    def flush(self) -> None:
        """Hands the rows so far to the operating system; they outlive this process from then on."""
        if not self._scalars:
            return
        try:
            self._rows_out.write(self._batch())
        finally:
            # Rows that cannot be stored are reported once; closing keeps those before them.
            self._scalars.clear()
            self._null[:] = False
        if self._flush_wall_s is not None:
            self._flushed_at_s = time.monotonic()

    def close(self) -> Path:
        """Turns the journal into `trace.parquet` and removes it. Closing twice does no harm.

        Returns:
            Path of the parquet file, which appears whole or not at all.
        """
        if not self._closed:
            self.flush()
            self._rows_out.close()
            self._closed = True
            convert(self.journal, self.path)
            self.journal.unlink()
        return self.path

    def __enter__(self) -> TraceWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        # After a failed write there is no room for a table: the journal stays, and `load` reads it.
        if not self._rows_out.broken:
            self.close()

    def _bind(self, row: _Row) -> Callable[[_Row], _Values]:
        """Looks once at how rows are built and returns the fastest way to take them apart."""
        scalar_columns = [c for c in self._columns if c.width is None]
        vector_columns = [c for c in self._columns if c.width is not None]
        if isinstance(row, Mapping):
            unknown = sorted(set(row) - {c.name for c in self._columns})
            if unknown:
                raise TraceError(f"{self.path}: the row has unknown columns {', '.join(unknown)}")
            scalar, vector = (
                itemgetter(*(c.name for c in kind)) for kind in (scalar_columns, vector_columns)
            )
            return lambda row: (scalar(row), vector(row))

        def cell(kind: list[Column]) -> attrgetter[tuple[Any, ...]]:
            return attrgetter(*(c.signal.name for c in kind if c.arm is None))

        def arm(kind: list[Column]) -> attrgetter[tuple[Any, ...]]:
            return attrgetter(*(c.signal.name for c in kind if c.arm == self._arms[0]))

        if not self._arms:
            only_scalar, only_vector = cell(scalar_columns), cell(vector_columns)
            return lambda row: (only_scalar(row), only_vector(row))
        cell_scalar, cell_vector = cell(scalar_columns), cell(vector_columns)
        arm_scalar, arm_vector = arm(scalar_columns), arm(vector_columns)
        records = attrgetter("arms")

        def take(row: _Row) -> _Values:
            scalars, vectors = cell_scalar(row), cell_vector(row)
            for name in self._arms:
                record = records(row)[name]
                scalars += arm_scalar(record)
                vectors += arm_vector(record)
            return scalars, vectors

        return take

    def _vector_fault(self, vectors: list[Any] | tuple[Any, ...]) -> str:
        for name, width, value in zip(self._vector_names, self._widths, vectors, strict=True):
            if value is None:
                return f"column {name} may not be null"
            if np.shape(value) != (width,):
                return f"column {name} has shape {np.shape(value)}, the layout asks for ({width},)"
            if not np.can_cast(np.asarray(value).dtype, float, "same_kind"):
                return f"column {name} holds {np.asarray(value).dtype}, not numbers"
        return "a vector column cannot be stored"

    def _batch(self) -> pa.RecordBatch:
        count = len(self._scalars)
        scalars = iter(zip(*self._scalars, strict=True))
        arrays, start, vector = [], 0, 0
        for column, field in zip(self._columns, self._schema, strict=True):
            if column.width is None:
                try:
                    array = _scalar_array(next(scalars, ()), field.type)
                except (pa.ArrowInvalid, pa.ArrowTypeError, OverflowError) as error:
                    raise TraceError(
                        f"{self.path}: column {column.name} takes {field.type}: {error}"
                    ) from error
            else:
                stop = start + column.width
                array = _list_array(self._block[:count, start:stop], self._null[:count, vector])
                start, vector = stop, vector + 1
            if array.null_count and not field.nullable:
                raise TraceError(f"{self.path}: column {column.name} may not be null")
            arrays.append(array)
        return pa.record_batch(arrays, schema=self._schema)


def schema(layout: Layout, metadata: Mapping[str, str]) -> pa.Schema:
    """The Arrow schema of a layout's columns, with the file metadata attached."""
    taken = sorted(set(metadata) & set(_LAYOUT_KEYS))
    if taken:
        raise TraceError(f"metadata keys {', '.join(taken)} are set by the layout")
    entries = {
        "schema_version": str(SCHEMA_VERSION),
        "arms": json.dumps(layout.arms),
        "joints": json.dumps(layout.joints),
        "nq": str(layout.nq),
        "nv": str(layout.nv),
        "pairs": json.dumps(layout.pairs),
        **metadata,
    }
    fields = []
    for column in columns(layout):
        kind = pa.type_for_alias(column.signal.dtype)
        if column.width is not None:
            kind = _LIST
        fields.append(pa.field(column.name, kind, nullable=column.signal.nullable))
    return pa.schema(fields, metadata=entries)


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
            pieces = pieces_of(self.rows, name, wanted, _ROW_GROUP_ROWS)
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


def convert(journal: Path, target: Path) -> None:
    """Writes a journal's intact batches as parquet, in memory that does not grow with the run."""
    batches = JournalReader(journal)
    temporary = target.with_name(target.name + ".part")
    floats = [
        field.name + (".list.element" if pa.types.is_list(field.type) else "")
        for field in batches.schema
        if pa.types.is_floating(getattr(field.type, "value_type", field.type))
    ]
    strings = [field.name for field in batches.schema if pa.types.is_string(field.type)]
    digest = TableDigest(batches.schema)
    try:
        with pq.ParquetWriter(
            temporary,
            batches.schema,
            compression="zstd",
            use_dictionary=strings,  # pyright: ignore[reportArgumentType] (pyarrow takes a list)
            column_encoding=dict.fromkeys(floats, "BYTE_STREAM_SPLIT"),
            write_page_checksum=True,
        ) as writer:
            for table in _regroup(batches):
                writer.write_table(table)
                for batch in table.to_batches():
                    digest.update(batch)
            writer.add_key_value_metadata({INTEGRITY_KEY: integrity(digest, batches.schema)})
        os.replace(temporary, target)
    except OSError as error:
        raise TraceError(f"{target}: cannot be written: {error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def _scalar_array(values: tuple[Any, ...], kind: pa.DataType) -> pa.Array:
    if pa.types.is_integer(kind):
        # Told the type, Arrow would cut 0.5 to 0 without a word; a cast refuses it.
        return pa.array(values).cast(kind)
    return pa.array(values, kind)


def _list_array(values: np.ndarray, null: np.ndarray) -> pa.ListArray:
    """Rows of a (T, n) array as lists; null rows take no room."""
    count, width = values.shape
    if null.any():
        offsets = np.concatenate([[0], np.cumsum(np.where(null, 0, width))]).astype(np.int32)
        flat, mask = values[~null].ravel(), pa.array(null)
    else:
        offsets = np.arange(count + 1, dtype=np.int32) * np.int32(width)
        flat, mask = values.flatten(), None
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(flat), type=_LIST, mask=mask)


def _regroup(batches: Iterator[pa.RecordBatch] | JournalReader) -> Iterator[pa.Table]:
    """The same rows in tables of `_ROW_GROUP_ROWS`, whatever the batches were."""
    waiting: list[pa.RecordBatch] = []
    rows = 0
    for batch in batches:
        waiting.append(batch)
        rows += len(batch)
        while rows >= _ROW_GROUP_ROWS:
            table = pa.Table.from_batches(waiting)
            yield table.slice(0, _ROW_GROUP_ROWS).combine_chunks()
            waiting = table.slice(_ROW_GROUP_ROWS).combine_chunks().to_batches()
            rows -= _ROW_GROUP_ROWS
    if rows:
        yield pa.Table.from_batches(waiting).combine_chunks()


def _check_schema(trace: Trace) -> None:
    entries = trace.rows.schema.metadata or {}
    missing = [key for key in _LAYOUT_KEYS if key.encode() not in entries]
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
