"""What the robot loop holds on this machine: `python -m workcell.robot.measure`.

Simulated robots in processes of their own, over UDP, with delays and drops put in. Prints how well the clock was
kept and how old readings were, and how long the robots took to stand when a robot, the loop or the checker was killed.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from workcell import run as runner
from workcell.control.controller import Controller
from workcell.robot.loop import RobotLoop
from workcell.robot.simulated import RobotSettings, SimulatedRobot, stood_after_s
from workcell.robot.udp import UdpRobot
from workcell.scenario import Scenario, load

Victim = Literal["robot", "loop", "checker"]
SCENARIO = "planar_crossing"
WATCHDOG_S = 0.12
"""Of the robots: six periods of 20 ms, so that a few lost datagrams do not stop them."""
KILLED_AT_S = 1.2
"""When the victim is killed: both arms are on their way."""
NETWORKS = (
    {},
    {"delay_s": 0.002, "jitter_s": 0.002},
    {"delay_s": 0.005, "jitter_s": 0.005, "dropped_fraction": 0.02},
    {"delay_s": 0.01, "jitter_s": 0.01, "dropped_fraction": 0.05},
)
"""Each way."""


@dataclass(frozen=True)
class Death:
    """What happened after a kill."""

    victim: Victim
    stood_s: dict[str, float | None]
    """How long after it each robot that lived stood for good; None: it did not."""


def scenario(period_s: float, duration_s: float) -> Scenario:
    """What the robots do."""
    return load(
        SCENARIO, (f"simulation.period_s={period_s}", f"simulation.duration_s={duration_s}")
    )


@contextmanager
def robots(what: Scenario, folder: Path, **network: Any) -> Iterator[dict[str, SimulatedRobot]]:
    """A simulated robot for every arm, where the arm starts."""
    cell, found = runner.prepare(what, folder / "robots"), {}
    try:
        for k, arm in enumerate(cell.arms):
            settings = RobotSettings(
                tuple(arm.home_rad.tolist()),
                tuple(arm.acceleration_limit_rad_s2.tolist()),
                watchdog_s=WATCHDOG_S,
                seed=k,
                **network,
            )
            found[arm.name] = SimulatedRobot(settings, folder / f"{arm.name}.npy")
        yield found
    finally:
        for robot in found.values():
            robot.end()


def adapters(addresses: dict[str, tuple[str, int]], what: Scenario) -> dict[str, UdpRobot]:
    """The reference adapter for each robot."""
    joints = {arm.name: len(arm.home_rad) for arm in what.arm}
    return {name: UdpRobot(address, joints=joints[name]) for name, address in addresses.items()}


def follow(period_s: float, duration_s: float, **network: Any) -> dict[str, Any]:
    """The robots' part of a run's summary."""
    what = scenario(period_s, duration_s)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with robots(what, folder, **network) as found:
            given = adapters({arm: robot.address for arm, robot in found.items()}, what)
            return RobotLoop(what, given, folder / "run").run()["robots"]


def kill(victim: Victim, period_s: float = 0.02) -> Death:
    """Kill one in the middle of a run, and see when the robots stand."""
    what = scenario(period_s, 4.0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with robots(what, folder) as found:
            addresses = {arm: robot.address for arm, robot in found.items()}
            killed_at_s = (
                _kill_loop(addresses, what, folder)
                if victim == "loop"
                else _kill_inside(victim, found, addresses, what, folder)
            )
            logs = {arm: robot.end() for arm, robot in found.items()}
    return Death(
        victim, {arm: stood_after_s(log, killed_at_s) for arm, log in logs.items() if len(log)}
    )


def _kill_inside(
    victim: Victim,
    found: dict[str, SimulatedRobot],
    addresses: dict[str, tuple[str, int]],
    what: Scenario,
    folder: Path,
) -> float:
    """Kill the surgeon's robot or the checker at a tick; when, on the monotonic clock."""
    loop, killed = RobotLoop(what, adapters(addresses, what), folder / "run"), [0.0]

    def watch(tick: int, controller: Controller) -> None:
        if tick == round(KILLED_AT_S / what.simulation.period_s):
            pid = found[what.arm[0].name].process.pid
            if victim == "checker" and loop.check is not None:
                pid = loop.check.pid or pid
            killed[0] = time.monotonic()
            os.kill(pid, signal.SIGKILL)

    loop.run(watch=watch)
    return killed[0]


def _kill_loop(addresses: dict[str, tuple[str, int]], what: Scenario, folder: Path) -> float:
    """Kill the process of the loop; when, on the monotonic clock."""
    context = multiprocessing.get_context("spawn")
    begun = context.Event()
    process = context.Process(target=_drive, args=(addresses, what, folder / "run", begun))
    process.start()
    begun.wait(60.0)
    time.sleep(KILLED_AT_S)
    killed_at_s = time.monotonic()
    process.kill()
    process.join()
    time.sleep(1.0)
    return killed_at_s


def _drive(addresses: dict[str, tuple[str, int]], what: Scenario, out: Path, begun: Any) -> None:
    def watch(tick: int, controller: Controller) -> None:
        begun.set()

    RobotLoop(what, adapters(addresses, what), out).run(watch=watch)


def main() -> None:
    """Print the tables of docs/robot.md."""
    print(
        "period  delay  jitter  lost | ticks missed | work median, p99 | age median, p99 | stopped"
    )
    for period_s in (0.02, 0.01):
        for network in NETWORKS:
            told = follow(period_s, 8.0, **network)
            times = [
                f"{1e3 * told[key][part]:.1f}" if told[key] else "-"
                for key in ("work_s", "age_s")
                for part in ("median", "p99")
            ]
            ways = [1e3 * network.get(key, 0.0) for key in ("delay_s", "jitter_s")]
            print(
                f"{1e3 * period_s:g} ms | {ways[0]:g} ms | {ways[1]:g} ms | {network.get('dropped_fraction', 0):.0%} | "
                f"{told['ticks']} | {told['missed']} | {times[0]}, {times[1]} ms | {times[2]}, {times[3]} ms | "
                f"{told['stopped'] or 'no'}",
                flush=True,
            )
    for victim in ("robot", "loop", "checker"):
        stood = kill(victim).stood_s
        print(f"killed: {victim}; stood after {stood}", flush=True)


if __name__ == "__main__":
    main()
