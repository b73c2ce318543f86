"""The shared slots: what is written is what is read, and never half of it."""

from __future__ import annotations

import mmap
import os
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from workcell.guard.shared_memory import (
    CLOSED,
    Answer,
    Request,
    SharedMemory,
    Slot,
    TornRead,
    shared_file,
)

# Large enough that copying it takes longer than the other process needs to change it.
PAYLOAD = 65536
# Enough reads of either kind to tell, and the time a slow machine is given for them, s.
ENOUGH, LIMIT_S = 200, 30.0
# The writer changes the whole payload at every turn, as fast as it can, until its pipe closes.
HAMMER = """
import mmap, select, sys
from workcell.guard.shared_memory import Slot
file, size = int(sys.argv[1]), int(sys.argv[2])
slot = Slot(memoryview(mmap.mmap(file, Slot.footprint(size))), 0, size)
turn = 0
while not select.select([0], [], [], 0)[0]:
    for _ in range(200):
        turn = turn % 255 + 1
        slot.write(bytes([turn]) * size)
        # A pause between writes, as any real writer makes: a lock whose writer never rests has
        # no moment at which a reader could succeed.
        for _ in range(300): pass
"""


@pytest.fixture
def file() -> Iterator[int]:
    descriptor = shared_file()
    yield descriptor
    os.close(descriptor)


def mapped(file: int, size: int) -> tuple[memoryview, Slot]:
    length = Slot.footprint(size)
    os.ftruncate(file, length)
    memory = memoryview(mmap.mmap(file, length))
    return memory, Slot(memory, 0, size)


def test_no_read_is_torn_while_another_process_hammers(file: int):
    memory, slot = mapped(file, PAYLOAD)
    slot.write(b"\1" * PAYLOAD)
    root = str(Path(__file__).parents[2])
    writer = subprocess.Popen(
        [sys.executable, "-c", HAMMER, str(file), str(PAYLOAD)],
        stdin=subprocess.PIPE,
        pass_fds=(file,),
        env=os.environ | {"PYTHONPATH": root},
    )
    try:
        whole, torn_without_lock, seen = 0, 0, set()
        until_s = time.monotonic() + LIMIT_S
        while time.monotonic() < until_s:
            if whole >= ENOUGH and torn_without_lock >= 1 and len(seen) > 5:
                break
            raw = bytes(memory[16 : 16 + PAYLOAD])
            torn_without_lock += raw != raw[:1] * PAYLOAD
            try:
                payload = slot.read()
            except TornRead:
                continue
            whole += 1
            seen.add(payload[0])
            assert payload == payload[:1] * PAYLOAD
    finally:
        assert writer.stdin is not None
        writer.stdin.close()
        assert writer.wait(10) == 0
    # The hammer bites: reading past the lock does show halves; and the lock lets readers through.
    assert torn_without_lock >= 1
    assert whole >= ENOUGH
    assert len(seen) > 5


def test_a_writer_that_died_while_writing_is_noticed_not_waited_for(file: int):
    memory, slot = mapped(file, 64)
    slot.write(b"a" * 64)
    memory[:8].cast("Q")[0] += 1
    with pytest.raises(TornRead):
        slot.read()
    slot.write(b"b" * 64)
    assert slot.read() == b"b" * 64


def test_a_changed_byte_is_noticed(file: int):
    memory, slot = mapped(file, 64)
    slot.write(b"a" * 64)
    memory[20:21] = b"b"
    with pytest.raises(TornRead):
        slot.read()


def test_both_ways_keep_every_field(file: int):
    here = SharedMemory(file, nq=3, n_exemptions=2)
    there = SharedMemory(file, nq=3, n_exemptions=2)
    assert there.request().sequence == 0
    assert here.newest_answer().sequence == 0
    here.post(Request(7, -3, (CLOSED, 12), np.array([0.1, -2.5, 3e-9])))
    request = there.request()
    assert (request.sequence, request.tick, request.opened_ticks) == (7, -3, (CLOSED, 12))
    assert request.qpos.tolist() == [0.1, -2.5, 3e-9]
    answer = Answer(7, -3, True, -0.25, (3, 9), float("inf"), (-1, -1), 1, 4e-4)
    there.answer(answer)
    assert here.newest_answer() == answer
    there.beat(12.5)
    assert here.last_beat_s == 12.5
    here.close()
    there.close()


def test_a_scribbled_answer_is_not_believed(file: int):
    link = SharedMemory(file, nq=1, n_exemptions=0)
    link.scribble()
    with pytest.raises(TornRead):
        link.newest_answer()
    link.close()


def test_slots_do_not_share_bytes(file: int):
    link = SharedMemory(file, nq=5, n_exemptions=1)
    link.answer(Answer(1, 1, False, 0.5, (-1, -1), 0.5, (-1, -1), -1, 0.0))
    for value in (0.0, struct.unpack("<d", b"\xff" * 8)[0]):
        link.post(Request(2, 2, (CLOSED,), np.full(5, value)))
        assert link.newest_answer().sequence == 1
    assert link.last_beat_s == 0.0
    link.close()
