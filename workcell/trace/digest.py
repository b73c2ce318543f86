"""A hash of what a table says, not of how it was cut into batches.

In come record batches of one schema in order; out comes the SHA-256 of their columns, equal for
equal rows whatever the batches were.
"""

from __future__ import annotations

import hashlib

import numpy as np
import pyarrow as pa


class TableDigest:
    """SHA-256 of columns, fed batch by batch."""

    def __init__(self, table_schema: pa.Schema):
        self._names = table_schema.names
        # Validity, lengths and values are hashed apart, so that cuts between batches leave no mark.
        self._parts = [[hashlib.sha256() for _ in range(3)] for _ in self._names]
        self._types = [str(t) for t in table_schema.types]

    def update(self, batch: pa.RecordBatch) -> None:
        """Adds the rows of a batch."""
        for array, (valid, lengths, values) in zip(batch.columns, self._parts, strict=True):
            valid.update(array.is_valid().to_numpy(zero_copy_only=False).view(np.uint8).data)
            if pa.types.is_list(array.type):
                lengths.update(np.diff(array.offsets.to_numpy()).data)
                array = array.flatten()
            elif pa.types.is_string(array.type):
                _, offset_buffer, data = array.buffers()
                end = array.offset + len(array) + 1
                offsets = np.frombuffer(offset_buffer, np.int32, end)[array.offset :]
                lengths.update(np.diff(offsets).data)
                if data is not None and len(offsets):
                    values.update(memoryview(data)[offsets[0] : offsets[-1]])
                continue
            if array.null_count:
                array = array.drop_null()
            values.update(np.ascontiguousarray(array.to_numpy(zero_copy_only=False)).data)

    def hexdigest(self) -> str:
        """The hash of all rows so far, with names and types of the columns."""
        whole = hashlib.sha256()
        for name, kind, parts in zip(self._names, self._types, self._parts, strict=True):
            whole.update(f"{name}|{kind}|{'|'.join(p.hexdigest() for p in parts)}\n".encode())
        return whole.hexdigest()
