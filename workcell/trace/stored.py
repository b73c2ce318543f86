"""The rows of a parquet trace, on disk: verified once, then read as they are asked for.

In comes a file; out come its columns, whole or a row group at a time. A ten-minute run has 1.5 GB
of rows, of which nearly all are two vectors over pairs; whoever goes through those in pieces needs
some ten megabytes whatever the length of the run. The file stays open, so that what is read is
what was verified, also where the run folder is written anew meanwhile.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NoReturn

import pyarrow as pa
import pyarrow.parquet as pq

from workcell.errors import TraceError
from workcell.trace.digest import TableDigest

INTEGRITY_KEY = b"integrity_sha256"
"""Metadata entry with the hash over rows and metadata."""

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
    table: pa.Table, name: str, ticks: Sequence[int] | None, rows: int
) -> Iterator[tuple[int, pa.ChunkedArray]]:
    """`StoredTable.pieces` of a table in memory, in pieces of so many rows."""
    for start in range(0, table.num_rows, rows):
        if _any_within(ticks, start, start + rows):
            yield start, table.column(name).slice(start, rows)


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
