"""The reference adapter: a robot that speaks the datagrams of `wire` over UDP."""

from __future__ import annotations

import contextlib
import socket

import numpy as np
from numpy.typing import NDArray

from workcell.robot import wire
from workcell.robot.adapter import Reading

LARGEST_DATAGRAM = 65_536


class UdpRobot:
    """One robot at an address.

    Args:
        address: Host and port of the robot.
        joints: How many it has.
    """

    def __init__(self, address: tuple[str, int], *, joints: int):
        self._joints = joints
        self._newest = -1
        self._number = -1
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect(address)
        # The robot learns from the first datagram whom to answer.
        self.write(self._number, np.zeros(joints))

    def read(self) -> Reading | None:
        """See `RobotAdapter`: datagrams that were overtaken by newer ones are left out."""
        found = None
        while True:
            try:
                datagram = self._socket.recv(LARGEST_DATAGRAM)
            except (BlockingIOError, ConnectionError):  # nothing more; nobody there
                break
            state = wire.state(datagram, self._joints)
            if state is not None and state.sequence > self._newest:
                self._newest, found = state.sequence, state
        if found is None:
            return None
        return Reading(
            found.position, found.velocity, found.acted_on, wire.STOPPED_BY[found.stopped]
        )

    def write(self, number: int, velocity_rad_s: NDArray[np.float64]) -> None:
        """See `RobotAdapter`."""
        self._number = number
        self._send(wire.CommandDatagram(number, False, np.array(velocity_rad_s)))

    def stop(self, reason: str) -> None:
        """See `RobotAdapter`."""
        self._send(wire.CommandDatagram(self._number, True, np.zeros(self._joints)))

    def close(self) -> None:
        """See `RobotAdapter`."""
        self._socket.close()

    def _send(self, datagram: wire.CommandDatagram) -> None:
        # One that cannot be sent is like one that is lost on the way: stale readings tell.
        with contextlib.suppress(BlockingIOError, ConnectionError):
            self._socket.send(datagram.pack())
