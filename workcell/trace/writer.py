"""A trace as it is written: one row a control tick, safe against a kill.

In comes a row a tick; out come `trace.parquet` and, while the run lasts, the journal `trace.arrows`
(an Arrow stream of small batches, each handed to the operating system at once, so that a kill costs
at most the batch being filled). Columns and their types follow from `workcell.signals`.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from operator import attrgetter, itemgetter
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pyarrow as pa

from workcell.errors import TraceError
from workcell.signals import SCHEMA_VERSION, Column, Layout, columns
from workcell.trace.journal import JournalWriter
from workcell.trace.stored import INDEX_NAME, convert
from workcell.trace.table import JOURNAL_NAME, LAYOUT_KEYS, TRACE_NAME

FLUSH_S = 0.5
"""Simulated time of rows that are handed on together; what a kill may cost."""

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
        for earlier in (self.path, self.path.with_name(INDEX_NAME)):
            earlier.unlink(missing_ok=True)
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
    taken = sorted(set(metadata) & set(LAYOUT_KEYS))
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
