"""The datagrams between the reference adapter and a robot: fixed layout, little endian.

    state    'WCS1', joints, sequence, acted on, stopped, positions, velocities
    command  'WCC1', joints, number, stop, velocities

A datagram of another layout is none of ours and is left out.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_STATE = struct.Struct("<4sIQqI")
_COMMAND = struct.Struct("<4sIqI")
_STATE_MAGIC, _COMMAND_MAGIC = b"WCS1", b"WCC1"

RUNNING, WATCHDOG, TOLD = 0, 1, 2
STOPPED_BY = ("", "watchdog", "told to")
"""What the number of a stop means."""


@dataclass(frozen=True)
class StateDatagram:
    """What a robot sends."""

    sequence: int
    acted_on: int
    stopped: int
    """Index into `STOPPED_BY`."""
    position: Array
    velocity: Array

    def pack(self) -> bytes:
        """As bytes."""
        head = _STATE.pack(
            _STATE_MAGIC, len(self.position), self.sequence, self.acted_on, self.stopped
        )
        return head + self.position.tobytes() + self.velocity.tobytes()


@dataclass(frozen=True)
class CommandDatagram:
    """What a robot is sent."""

    number: int
    stop: bool
    velocity: Array

    def pack(self) -> bytes:
        """As bytes."""
        head = _COMMAND.pack(_COMMAND_MAGIC, len(self.velocity), self.number, self.stop)
        return head + self.velocity.tobytes()


def state(datagram: bytes, joints: int) -> StateDatagram | None:
    """A state for so many joints; None if it is something else, or holds a number that is not finite."""
    if len(datagram) != _STATE.size + 16 * joints:
        return None
    magic, count, sequence, acted_on, stopped = _STATE.unpack_from(datagram)
    values = np.frombuffer(datagram, dtype="<f8", offset=_STATE.size)
    if magic != _STATE_MAGIC or count != joints or stopped >= len(STOPPED_BY):
        return None
    if not np.isfinite(values).all():
        return None
    return StateDatagram(
        sequence, acted_on, stopped, values[:joints].copy(), values[joints:].copy()
    )


def command(datagram: bytes, joints: int) -> CommandDatagram | None:
    """A command for so many joints; None if it is something else, or holds a number that is not finite."""
    if len(datagram) != _COMMAND.size + 8 * joints:
        return None
    magic, count, number, stop = _COMMAND.unpack_from(datagram)
    values = np.frombuffer(datagram, dtype="<f8", offset=_COMMAND.size)
    if magic != _COMMAND_MAGIC or count != joints or not np.isfinite(values).all():
        return None
    return CommandDatagram(number, bool(stop), values.copy())
