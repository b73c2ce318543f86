"""The journal of a run: batches of rows on disk while the run lasts.

In come Arrow record batches, out comes a stream that a kill can only cut at its end. Every batch
carries a CRC-32 of the schema and of its own content, so that a batch that was cut off, which is
dropped, can be told from one that was damaged, which is refused.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa

from workcell.errors import TraceError

_CRC_KEY = b"workcell_crc32"
_MESSAGE_OPENING = b"\xff\xff\xff\xff"
_END_OF_STREAM = _MESSAGE_OPENING + bytes(4)
"""What ends an Arrow stream that was closed; one that was cut off lacks it."""


class JournalWriter:
    """Appends batches of one schema to a journal.

    Args:
        path: File to write, replaced if it is there.
        schema: Columns of the batches.

    Raises:
        TraceError: The file cannot be written.
    """

    def __init__(self, path: Path, schema: pa.Schema):
        self.path = path
        self.broken = False
        """Whether a write has failed; what was written before stays readable."""
        self._end = 0
        self._memory = io.BytesIO()
        self._stream = pa.ipc.new_stream(self._memory, schema)
        try:
            self._file = path.open("wb", buffering=0)
        except OSError as error:
            raise TraceError(f"{path}: cannot be written: {error}") from error
        self._schema_crc = zlib.crc32(schema.serialize())

    def write(self, batch: pa.RecordBatch) -> None:
        """Hands a batch to the operating system: it outlives this process from then on."""
        checksum = _checksum(batch, self._schema_crc)
        self._stream.write_batch(batch, custom_metadata={_CRC_KEY: checksum})
        self._hand_over()

    def close(self) -> None:
        """Ends the journal."""
        self._stream.close()
        self._hand_over()
        self._file.close()

    def _hand_over(self) -> None:
        """Write what Arrow has laid down in memory, all of it or none."""
        content = self._memory.getvalue()
        self._memory.seek(0)
        self._memory.truncate()
        if self.broken:
            raise TraceError(f"{self.path}: an earlier write has failed")
        rest = memoryview(content)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            # On a full disk a part may have been written; without it the journal ends with a whole batch.
            self.broken = True
            self._file.truncate(self._end)
            self._file.close()
            raise TraceError(
                f"{self.path}: cannot be written: {error}; what was written before is intact"
            ) from error
        self._end += len(content)


class JournalReader:
    """Iterates over the intact batches of a journal.

    `torn_bytes` is how much of an unfinished last batch was dropped, known when the iteration has
    come to its end.

    Raises:
        TraceError: The file is no journal, or is damaged before its last batch.
    """

    def __init__(self, path: Path):
        self.path = path
        self.torn_bytes = 0
        self._file = pa.OSFile(str(path))
        try:
            self._reader = pa.ipc.open_stream(self._file)
            # The reader reads ahead. A second handle, moved on by a message whenever the reader
            # has given an intact one, knows where the last intact batch ends.
            self._intact = pa.OSFile(str(path))
            pa.ipc.read_message(self._intact)
        except (OSError, pa.ArrowException) as error:
            raise TraceError(f"{path}: is not a journal of a trace: {error}") from error
        self.schema: pa.Schema = self._reader.schema
        self._schema_crc = zlib.crc32(self.schema.serialize())

    def __iter__(self) -> Iterator[pa.RecordBatch]:
        intact = 0
        with self._file, self._intact:
            while True:
                try:
                    batch, custom = self._reader.read_next_batch_with_custom_metadata()
                    # Offsets are validated before anything follows them.
                    batch.validate(full=True)
                    checksum = _checksum(batch, self._schema_crc)
                    stored = (custom or {}).get(_CRC_KEY)
                    if checksum != stored:
                        raise TraceError(f"its CRC-32 is {checksum!r}, written was {stored!r}")
                    pa.ipc.read_message(self._intact)
                except StopIteration:
                    return self._finish(intact, TraceError("its length is zero"), torn=True)
                except (OSError, pa.ArrowException) as error:
                    return self._finish(intact, error, torn=True)
                except TraceError as error:
                    return self._finish(intact, error, torn=False)
                intact += 1
                yield batch

    def _finish(self, intact: int, error: Exception, *, torn: bool) -> None:
        """Tells the end, and a batch cut short by a kill, which is dropped, from damage."""
        end = self._intact.tell()
        content = self.path.read_bytes()
        if content[end:] in (b"", _END_OF_STREAM):
            return
        # A kill leaves the beginning of a batch, which opens like the end mark, and every batch has
        # one checksum entry: there is at most one beyond the intact ones.
        opening = _END_OF_STREAM[:4].startswith(content[end : end + 4])
        if not (torn and opening) or content.count(_CRC_KEY) > intact + 1:
            fault = f"{self.path}: the batch at byte {end} is damaged: {error}"
            raise TraceError(fault) from error
        self.torn_bytes = len(content) - end


def intact_batches(path: Path, losses: list[str]) -> Iterator[pa.RecordBatch]:
    """The batches of a damaged journal whose checksums hold, also those behind the damage.

    Args:
        path: The journal. Its first message, the schema, must be whole.
        losses: Gets one sentence for every stretch of bytes that holds no intact batch.

    Raises:
        TraceError: The schema is damaged, and with it what every batch means.
    """
    content = path.read_bytes()
    try:
        source = pa.BufferReader(content)
        schema = pa.ipc.open_stream(source).schema
        source.seek(0)
        pa.ipc.read_message(source)
        offset = source.tell()
    except (OSError, pa.ArrowException) as error:
        raise TraceError(f"{path}: is not a journal of a trace: {error}") from error
    opening, schema_crc = content[:offset], zlib.crc32(schema.serialize())
    lost_from: int | None = None
    while 0 <= offset < len(content) and content[offset:] != _END_OF_STREAM:
        found = _batch_at(content, offset, opening, schema_crc)
        if found is None:
            lost_from = offset if lost_from is None else lost_from
            offset = content.find(_MESSAGE_OPENING, offset + 1)
            continue
        batch, end = found
        if lost_from is not None:
            losses.append(f"{path}: bytes {lost_from} to {offset - 1} hold no intact batch")
            lost_from = None
        yield batch
        offset = end
    if lost_from is not None:
        count = len(content) - lost_from
        losses.append(f"{path}: its last {count} bytes are an unfinished or damaged batch")


def _batch_at(
    content: bytes, offset: int, opening: bytes, schema_crc: int
) -> tuple[pa.RecordBatch, int] | None:
    """The batch that begins at this byte and where it ends; None if none does whose checksum holds."""
    rest = memoryview(content)[offset:]
    try:
        source = pa.BufferReader(rest)
        pa.ipc.read_message(source)
        end = source.tell()
        with pa.ipc.open_stream(pa.BufferReader(opening + bytes(rest[:end]))) as stream:
            batch, custom = stream.read_next_batch_with_custom_metadata()
        batch.validate(full=True)
    except (OSError, EOFError, StopIteration, pa.ArrowException):
        return None
    if (custom or {}).get(_CRC_KEY) != _checksum(batch, schema_crc):
        return None
    return batch, offset + end


def _checksum(batch: pa.RecordBatch, schema_crc: int) -> bytes:
    return b"%08x" % zlib.crc32(batch.serialize(), schema_crc)
