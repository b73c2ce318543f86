"""The rows of a parquet trace, on disk: verified once, then read as they are asked for.

`convert` writes the file from a journal; `StoredTable` gives its columns, whole or a row group at a
time. A ten-minute run has 1.5 GB of rows. Nearly all of them are two vectors over pairs; a reader
that goes through those in pieces needs some ten megabytes, whatever the length of the run. The file
stays open, so that the rows that are read are the rows that were verified, even if the run folder is
written anew meanwhile.
"""

from __future__ import annotations

import hashlib
import os
import struct
import zlib
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NoReturn

import pyarrow as pa
import pyarrow.parquet as pq

from workcell.errors import TraceError
from workcell.trace.digest import TableDigest
from workcell.trace.journal import JournalReader

INTEGRITY_KEY = b"integrity_sha256"
"""Metadata entry with the hash over rows and metadata."""

_ROW_GROUP_ROWS = 8192
"""Rows a row group holds, and a block of a column: chosen so that a conversion needs some ten
megabytes whatever the length of the run, while columns stay long enough to compress."""
_FIRST_GROUP_ROWS = 512
"""Rows of each group up to the first `_ROW_GROUP_ROWS`: damage costs a group, and a run of half a minute
has no more rows than that."""

INDEX_NAME = "trace.index"
"""Copy of the parquet file's index: without one, a damaged byte in it would cost every row."""
_PARQUET_END_BYTES = 8
"""A parquet file ends with the length of its index and four letters."""

_RECENT = 8
"""Columns of scalars that are kept, the time above all, which is asked for again and again; chosen for
some twenty megabytes in ten minutes of run."""
_UNREADABLE = (OSError, pa.ArrowException, UnicodeDecodeError)


class StoredTable:
    """A parquet trace whose rows stay in the file.

    Args:
        path: The file. All of it is read once, group by group, and held against its stored hash.

    Raises:
        TraceError: It is no trace, or damaged.
    """

    def __init__(self, path: Path):
        self.path = path
        try:
            self._file = pq.ParquetFile(path, page_checksum_verification=True)
            self.schema: pa.Schema = self._file.schema_arrow
            stored = (self._file.metadata.metadata or {}).get(INTEGRITY_KEY)
        except _UNREADABLE as error:
            self._refuse(error)
        if stored is None:
            raise TraceError(
                f"{path}: has no entry {INTEGRITY_KEY.decode()}: not a trace, or damaged"
            )
        self._recent: dict[str, pa.Array] = {}
        digest = TableDigest(self.schema)
        self._starts = [0]
        try:
            for group in range(self._file.num_row_groups):
                table = self._file.read_row_group(group)
                for batch in table.to_batches():
                    digest.update(batch)
                # Counted, not taken from the index, which no checksum of a page covers.
                self._starts.append(self._starts[-1] + table.num_rows)
        except _UNREADABLE as error:
            self._refuse(error)
        if integrity(digest, self.schema) != stored:
            raise TraceError(f"{path}: is damaged: rows and metadata do not match the stored hash")
        self.digest = digest.hexdigest()
        """SHA-256 over columns and rows."""

    @property
    def num_rows(self) -> int:
        """Rows of the file."""
        return self._starts[-1]

    def read(self) -> pa.Table:
        """All of it, in memory."""
        try:
            return self._file.read()
        except _UNREADABLE as error:
            self._refuse(error)

    def column(self, name: str) -> pa.Array:
        """A whole column; the last few are kept, so it should be one of scalars."""
        values = self._recent.pop(name, None)
        if values is None:
            try:
                values = self._file.read(columns=[name]).column(name).combine_chunks()
            except _UNREADABLE as error:
                self._refuse(error)
        self._recent[name] = values
        if len(self._recent) > _RECENT:
            del self._recent[next(iter(self._recent))]
        return values

    def pieces(
        self, name: str, ticks: Sequence[int] | None
    ) -> Iterator[tuple[int, pa.ChunkedArray]]:
        """First row and values of every row group that holds one of the rising `ticks`; None: of all."""
        for group, start in enumerate(self._starts[:-1]):
            if not _any_within(ticks, start, self._starts[group + 1]):
                continue
            try:
                values = self._file.read_row_group(group, columns=[name]).column(name)
            except _UNREADABLE as error:
                self._refuse(error)
            yield start, values

    def _refuse(self, error: Exception) -> NoReturn:
        raise TraceError(f"{self.path}: is damaged or no parquet file: {error}") from error


def pieces_of(
    table: pa.Table, name: str, ticks: Sequence[int] | None
) -> Iterator[tuple[int, pa.ChunkedArray]]:
    """`StoredTable.pieces` of a table in memory, as if it lay in row groups."""
    for start in range(0, table.num_rows, _ROW_GROUP_ROWS):
        if _any_within(ticks, start, start + _ROW_GROUP_ROWS):
            yield start, table.column(name).slice(start, _ROW_GROUP_ROWS)


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
        with (
            pq.ParquetWriter(
                temporary,
                batches.schema,
                compression="zstd",
                use_dictionary=strings,  # pyright: ignore[reportArgumentType] (pyarrow takes a list)
                write_statistics=False,  # Nobody searches a trace by value, and the index is half as long.
                column_encoding=dict.fromkeys(floats, "BYTE_STREAM_SPLIT"),
                write_page_checksum=True,
            ) as writer
        ):
            for table in _regroup(batches):
                writer.write_table(table)
                for batch in table.to_batches():
                    digest.update(batch)
            writer.add_key_value_metadata({INTEGRITY_KEY: integrity(digest, batches.schema)})
        index = target.with_name(INDEX_NAME)
        index_part = index.with_name(index.name + ".part")
        index_part.write_bytes(_index_copy(temporary))
        os.replace(index_part, index)
        os.replace(temporary, target)
    except OSError as error:
        raise TraceError(f"{target}: cannot be written: {error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def _index_copy(parquet: Path) -> bytes:
    """Where a file's index begins, the bytes from there to its end, and a CRC-32 of both."""
    with parquet.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(size - _PARQUET_END_BYTES)
        (length,) = struct.unpack("<I", file.read(4))
        start = size - _PARQUET_END_BYTES - length
        file.seek(start)
        content = struct.pack("<Q", start) + file.read()
    return content + struct.pack("<I", zlib.crc32(content))


def with_index_of(index: Path, parquet: Path) -> bytes | None:
    """A parquet file with its index taken from the copy; None where the copy is missing or damaged.

    Bytes that the file has lost at its end are filled with zeros, so that what lies before them is
    found where the index says.
    """
    content = index.read_bytes() if index.is_file() else b""
    if len(content) < 12 or struct.pack("<I", zlib.crc32(content[:-4])) != content[-4:]:
        return None
    (start,) = struct.unpack("<Q", content[:8])
    return parquet.read_bytes()[:start].ljust(start, b"\0") + content[8:-4]


def _regroup(batches: Iterator[pa.RecordBatch] | JournalReader) -> Iterator[pa.Table]:
    """The same rows in tables of a row group, whatever the batches were."""
    waiting: list[pa.RecordBatch] = []
    rows = done = 0
    wanted = min(_FIRST_GROUP_ROWS, _ROW_GROUP_ROWS)
    for batch in batches:
        waiting.append(batch)
        rows += len(batch)
        while rows >= wanted:
            table = pa.Table.from_batches(waiting)
            yield table.slice(0, wanted).combine_chunks()
            waiting = table.slice(wanted).combine_chunks().to_batches()
            rows, done = rows - wanted, done + wanted
            wanted = _ROW_GROUP_ROWS if done >= _ROW_GROUP_ROWS else wanted
    if rows:
        yield pa.Table.from_batches(waiting).combine_chunks()


def integrity(digest: TableDigest, table_schema: pa.Schema) -> bytes:
    """Hash of rows and metadata: page checksums leave the footer, where metadata is, uncovered."""
    entries = sorted((table_schema.metadata or {}).items())
    whole = hashlib.sha256(digest.hexdigest().encode())
    for key, value in entries:
        if key != INTEGRITY_KEY:
            whole.update(b"%d %b %d %b" % (len(key), key, len(value), value))
    return whole.hexdigest().encode()


def _any_within(ticks: Sequence[int] | None, start: int, stop: int) -> bool:
    if ticks is None:
        return True
    first = bisect_left(ticks, start)
    return first < len(ticks) and ticks[first] < stop
