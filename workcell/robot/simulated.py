"""A robot to try things on: joints that follow velocities, a watchdog, and a network that is late and loses datagrams.

It runs in a process of its own, on the wall clock, and sends its state every period. Each joint changes its velocity
by what its acceleration limit allows. A command holds for `watchdog_s`; then the robot brakes, and goes on with
the next command. Told to stop, it brakes and stays. When it is ended (SIGTERM), it leaves a log.
"""

from __future__ import annotations

import heapq
import itertools
import json
import signal
import socket
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workcell.robot import wire

Array = NDArray[np.float64]

START_S = 20.0
"""Longest time until the process of a robot is there."""
STANDS_RAD_S = 1e-9
"""Slower than this a joint stands."""


@dataclass(frozen=True)
class RobotSettings:
    """One simulated robot."""

    position_rad: tuple[float, ...]
    """Where its joints are at the start."""
    acceleration_rad_s2: tuple[float, ...]
    """With which they follow and brake."""
    period_s: float = 0.002
    """Of its own loop and its states."""
    watchdog_s: float = 0.05
    """How long a command holds."""
    delay_s: float = 0.0
    """Of every datagram, each way."""
    jitter_s: float = 0.0
    """Added to it, uniform; datagrams may overtake each other."""
    dropped_fraction: float = 0.0
    """Of datagrams that never arrive, each way."""
    seed: int = 0
    """Of jitter and drops."""


class _Network:
    """Datagrams on their way."""

    def __init__(self, settings: RobotSettings, stream: int):
        self._settings, self._count = settings, itertools.count()
        self._random = np.random.default_rng([settings.seed, stream])
        self._under_way: list[tuple[float, int, bytes]] = []

    def put(self, datagram: bytes, now_s: float) -> None:
        """Send one."""
        settings = self._settings
        late_s = settings.delay_s + settings.jitter_s * self._random.random()
        if self._random.random() >= settings.dropped_fraction:
            heapq.heappush(self._under_way, (now_s + late_s, next(self._count), datagram))

    def arrived(self, now_s: float) -> list[bytes]:
        """What has arrived by now."""
        found = []
        while self._under_way and self._under_way[0][0] <= now_s:
            found.append(heapq.heappop(self._under_way)[2])
        return found


class _Joints:
    """The robot's joints and what they were told."""

    def __init__(self, settings: RobotSettings, now_s: float):
        self._settings = settings
        self.position = np.array(settings.position_rad, dtype=float)
        self.velocity = np.zeros(len(self.position))
        self._wanted = self.velocity
        self._told_at_s = now_s
        self.number, self.stopped = -1, wire.RUNNING

    def take(self, command: wire.CommandDatagram, now_s: float) -> None:
        """A command has arrived; one that was overtaken by a newer one is not done."""
        if command.stop:
            self.stopped = wire.TOLD
        elif command.number > self.number:
            self.number, self._wanted, self._told_at_s = command.number, command.velocity, now_s

    def move(self, dt_s: float, now_s: float) -> None:
        """Follow, or brake."""
        if self.stopped != wire.TOLD:
            late = now_s - self._told_at_s > self._settings.watchdog_s
            self.stopped = wire.WATCHDOG if late and self.number >= 0 else wire.RUNNING
        wanted = self._wanted if self.stopped == wire.RUNNING else np.zeros(len(self.position))
        most = np.asarray(self._settings.acceleration_rad_s2) * dt_s
        before = self.velocity
        self.velocity = before + np.clip(wanted - before, -most, most)
        self.position = self.position + 0.5 * (before + self.velocity) * dt_s


def serve(settings: RobotSettings, log: Path) -> None:
    """Be a robot until SIGTERM; the first line on standard output is the port."""
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: ended.append(number))
    rows: list[tuple[float, float, int]] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wires:
        wires.bind(("127.0.0.1", 0))
        wires.setblocking(False)
        print(wires.getsockname()[1], flush=True)
        inwards, outwards = _Network(settings, 0), _Network(settings, 1)
        joints, peer = _Joints(settings, time.monotonic()), None
        before_s = time.monotonic()
        for tick in itertools.count():
            if ended:
                break
            now_s = time.monotonic()
            while True:
                try:
                    datagram, peer = wires.recvfrom(65_536)
                except (BlockingIOError, ConnectionError):
                    break
                inwards.put(datagram, now_s)
            for datagram in inwards.arrived(now_s):
                command = wire.command(datagram, len(joints.position))
                if command is not None:
                    joints.take(command, now_s)
            joints.move(now_s - before_s, now_s)
            before_s = now_s
            told = wire.StateDatagram(
                tick, joints.number, joints.stopped, joints.position, joints.velocity
            )
            outwards.put(told.pack(), now_s)
            for datagram in outwards.arrived(now_s):
                if peer is not None:
                    try:
                        wires.sendto(datagram, peer)
                    except (BlockingIOError, ConnectionError):
                        continue  # nobody listens any more
            rows.append((now_s, float(np.abs(joints.velocity).max()), joints.stopped))
            time.sleep(max(0.0, settings.period_s - (time.monotonic() - now_s)))
    np.save(log, np.array(rows))


class SimulatedRobot:
    """A robot in a process of its own. Use it as a context.

    Args:
        settings: What it is like.
        log: Where it leaves its log, a `.npy` of (time on the monotonic clock in s, fastest joint in rad/s, stop).
    """

    def __init__(self, settings: RobotSettings, log: Path):
        self.log = log
        command = [
            sys.executable,
            "-m",
            "workcell.robot.simulated",
            json.dumps(asdict(settings)),
            str(log),
        ]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.address: tuple[str, int] = ("127.0.0.1", int(self.process.stdout.readline()))

    def __enter__(self) -> SimulatedRobot:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> Array:
        """End it; its log (T, 3), empty if it was killed."""
        self.process.terminate()
        self.process.wait(START_S)
        if self.process.stdout is not None:
            self.process.stdout.close()
        return np.load(self.log) if self.log.is_file() else np.empty((0, 3))


def stood_after_s(log: Array, since_s: float) -> float | None:
    """How long after a time on the monotonic clock a robot stood for good; None if it did not by the end of its log.

    Args:
        log: (T, 3) as `SimulatedRobot.end` has it.
        since_s: On the monotonic clock.
    """
    moving = log[:, 1] > STANDS_RAD_S
    if not len(log) or moving[-1]:
        return None
    last = np.flatnonzero(moving)
    return 0.0 if not len(last) else max(0.0, float(log[last[-1] + 1, 0]) - since_s)


if __name__ == "__main__":
    given = json.loads(sys.argv[1])
    serve(RobotSettings(**given), Path(sys.argv[2]))
