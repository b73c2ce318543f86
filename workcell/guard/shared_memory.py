"""The memory the controller's process shares with the checker's, and how neither reads it torn.

Two slots: requests one way, answers the other, each with one writer. A writer makes the slot's
counter odd, writes, and makes it even again; a reader that saw an odd or a changed counter tries
again (sequence lock). Each slot also carries a checksum, because Python cannot promise the order
in which another core sees plain stores: a slot is believed only if both agree. The memory has no
name in any file system: it is an open file that the child inherits, so nothing can be left over.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Attempts before a read gives up. A write takes microseconds, so a reader that fails this often
# is looking at a writer that died or was stopped while writing.
READ_ATTEMPTS = 1000
# Idle, the checker wakes this often to beat and to look whether its parent is still there, s.
# Chosen below the live deadline, so that a missing beat is noticed within one deadline.
BEAT_S = 0.02
# In place of the tick at which an exemption was opened.
CLOSED = -1
# In place of the arm that holds an instrument.
NOBODY = -1

_COUNTER = struct.Struct("<Q")
_CHECKSUM = struct.Struct("<I4x")
_REQUEST_HEAD = struct.Struct("<Qq")
_ANSWER = struct.Struct("<Qq?7xdqqdqqqd")


class TornRead(Exception):
    """A slot did not come to rest within `READ_ATTEMPTS`, or its checksum is wrong."""


@dataclass(frozen=True)
class Request:
    """What the checker is asked."""

    sequence: int
    """Counts requests from 1; 0 is an empty slot."""
    tick: int
    """Control tick of the configuration."""
    opened_ticks: tuple[int, ...]
    """For each exemption the tick at which its window was opened, or CLOSED."""
    qpos: NDArray[np.float64]
    """(nq,) configuration to check."""
    holders: tuple[int, ...] = ()
    """For each instrument the index of the arm that holds it, or NOBODY."""


@dataclass(frozen=True)
class Answer:
    """What the checker says."""

    sequence: int
    """Of the request that is answered; 0 is an empty slot."""
    tick: int
    """Of that request."""
    halt: bool
    """The checker's own verdict."""
    distance_m: float
    """Smallest non-exempt distance, or the ceiling, m."""
    pair: tuple[int, int]
    """Indices of its two pieces; (-1, -1) at the ceiling."""
    exempt_distance_m: float
    """Smallest distance of the pairs exempt in this request, m; infinite where none are."""
    exempt_pair: tuple[int, int]
    """Indices of its two pieces; (-1, -1) where there are none."""
    exemption_fault: int
    """Index of the exemption whose terms were broken, or -1."""
    compute_s: float
    """Time the check took, s of wall clock."""


class Slot:
    """One writer, any number of readers, `size` bytes of payload, at `offset` of a memory."""

    def __init__(self, memory: memoryview, offset: int, size: int):
        self.size = size
        self._counter = memory[offset : offset + 8].cast("Q")
        self._checksum = memory[offset + 8 : offset + 16].cast("Q")
        self._payload = memory[offset + 16 : offset + 16 + size]

    @staticmethod
    def footprint(size: int) -> int:
        """Bytes a slot of this payload takes, a multiple of 64 to keep slots on own cache lines."""
        return -(-(16 + size) // 64) * 64

    def write(self, payload: bytes) -> None:
        """Replaces the payload."""
        count = self._counter[0]
        # A writer that was replaced may have left the counter odd; odd it must be while writing.
        self._counter[0] = count = count + 1 if count % 2 == 0 else count
        self._checksum[0] = zlib.crc32(payload)
        self._payload[:] = payload
        self._counter[0] = count + 1

    def read(self) -> bytes:
        """A payload exactly as one `write` wrote it.

        Raises:
            TornRead: If there is none to be had.
        """
        for _ in range(READ_ATTEMPTS):
            before = self._counter[0]
            if before % 2:
                continue
            payload = bytes(self._payload)
            checksum = self._checksum[0]
            if self._counter[0] == before and zlib.crc32(payload) == checksum:
                return payload
        raise TornRead(f"no whole payload in {READ_ATTEMPTS} attempts")

    def release(self) -> None:
        """Lets go of the memory."""
        for view in (self._counter, self._checksum, self._payload):
            view.release()


class SharedMemory:
    """Both slots, and the beat of the checker's heart, in one inherited file.

    Args:
        file: Descriptor of the shared file.
        nq: Length of a configuration.
        n_exemptions: Number of declared exemptions.
        n_instruments: Number of declared instruments.
    """

    def __init__(self, file: int, *, nq: int, n_exemptions: int, n_instruments: int = 0):
        self._n_exemptions, self._n_instruments = n_exemptions, n_instruments
        request_size = _REQUEST_HEAD.size + 8 * (n_exemptions + n_instruments + nq)
        answer_offset = Slot.footprint(request_size)
        beat_offset = answer_offset + Slot.footprint(_ANSWER.size)
        length = beat_offset + 64
        if os.fstat(file).st_size < length:
            os.ftruncate(file, length)
            empty = True
        else:
            empty = False
        self._map = mmap.mmap(file, length)
        self._memory = memoryview(self._map)
        self._requests = Slot(self._memory, 0, request_size)
        self._answers = Slot(self._memory, answer_offset, _ANSWER.size)
        self._beat = self._memory[beat_offset : beat_offset + 8].cast("d")
        if empty:
            nothing = (CLOSED,) * n_exemptions
            self.post(Request(0, 0, nothing, np.zeros(nq), (NOBODY,) * n_instruments))
            self.answer(Answer(0, 0, False, 0.0, (-1, -1), 0.0, (-1, -1), -1, 0.0))

    def post(self, request: Request) -> None:
        """Writes a request (controller's side)."""
        self._requests.write(
            _REQUEST_HEAD.pack(request.sequence, request.tick)
            + struct.pack(f"<{self._n_exemptions}q", *request.opened_ticks)
            + struct.pack(f"<{self._n_instruments}q", *request.holders)
            + np.ascontiguousarray(request.qpos, dtype=np.float64).tobytes()
        )

    def request(self) -> Request:
        """Reads the newest request (checker's side). Raises TornRead."""
        payload = self._requests.read()
        sequence, tick = _REQUEST_HEAD.unpack_from(payload)
        opened = struct.unpack_from(f"<{self._n_exemptions}q", payload, _REQUEST_HEAD.size)
        start = _REQUEST_HEAD.size + 8 * self._n_exemptions
        holders = struct.unpack_from(f"<{self._n_instruments}q", payload, start)
        qpos = np.frombuffer(payload, np.float64, offset=start + 8 * self._n_instruments)
        return Request(sequence, tick, opened, qpos, holders)

    def answer(self, answer: Answer) -> None:
        """Writes an answer (checker's side)."""
        self._answers.write(
            _ANSWER.pack(
                answer.sequence,
                answer.tick,
                answer.halt,
                answer.distance_m,
                *answer.pair,
                answer.exempt_distance_m,
                *answer.exempt_pair,
                answer.exemption_fault,
                answer.compute_s,
            )
        )

    def newest_answer(self) -> Answer:
        """Reads the newest answer (controller's side). Raises TornRead."""
        fields = _ANSWER.unpack(self._answers.read())
        sequence, tick, halt, distance_m, i, j, exempt_m, k, m, fault, compute_s = fields
        return Answer(sequence, tick, halt, distance_m, (i, j), exempt_m, (k, m), fault, compute_s)

    def scribble(self) -> None:
        """Overwrites the answer with bytes no checker writes (for the tests of the fail-safe)."""
        self._answers._payload[:] = b"\xa5" * self._answers.size

    def beat(self, now_s: float) -> None:
        """The checker is alive at `now_s` of the monotonic clock, which both processes share."""
        self._beat[0] = now_s

    @property
    def last_beat_s(self) -> float:
        """When the checker last said that it is alive, s of the monotonic clock."""
        return self._beat[0]

    def close(self) -> None:
        """Unmaps the memory; the file itself goes with its last descriptor."""
        self._requests.release()
        self._answers.release()
        self._beat.release()
        self._memory.release()
        self._map.close()


def shared_file() -> int:
    """Descriptor of a new file that never has a name others could find; the caller closes it."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("workcell-guard")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())
