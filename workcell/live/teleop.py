"""Live tele-operation: MuJoCo's passive viewer at one end, a run like any other behind it.

    mouse, keys, gamepad -> marker of the target -> samples -> live operator -> controller -> trace

Time is the wall clock's, held back to one tick a period; a tick that comes late is counted and
reported. The window (workcell.live.window) draws in threads of its own, on a model of its own, so that
the scene that is simulated is the one a replay uses.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from workcell import run as runner
from workcell.control.controller import Controller
from workcell.errors import InputError
from workcell.live.devices import CRITERIA, T_MIN_STEP_S, Steering
from workcell.live.operator_file import write_replay
from workcell.live.stream import Stream
from workcell.live.window import FRAME_S, Picture, Pose, Window
from workcell.motion.operators.live import LiveOperator
from workcell.motion.operators.samples import Sample
from workcell.scenario import Live, Scenario
from workcell.scene.cell import Cell

GIVE_UP_S = 0.1
"""When this far behind the clock, the run goes on from where it is instead of racing to catch up."""
SMALLEST_T_MIN_S = 0.1


@dataclass
class RealTime:
    """How well a live run kept to the clock."""

    ticks: int = 0
    missed: int = 0
    """Ticks that began more than one period after their time."""
    worst_late_s: float = 0.0
    """Largest lateness of a tick."""
    slipped_s: float = 0.0
    """Time by which the run fell behind the clock for good."""
    frames: int = 0
    """Pictures shown."""


class Pace:
    """Holds a run back to the wall clock.

    Args:
        period_s: Length of a tick.
        clock, sleep: Replaced in tests.
    """

    def __init__(
        self,
        period_s: float,
        *,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ):
        self._period_s, self._clock, self._sleep = period_s, clock, sleep
        self._start_s: float | None = None
        self.account = RealTime()

    def wait(self, tick: int) -> None:
        """Return when it is time for a tick, at once if that is past."""
        now = self._clock()
        if self._start_s is None:
            self._start_s = now - tick * self._period_s
        late = now - self._start_s - tick * self._period_s
        account = self.account
        account.ticks += 1
        account.worst_late_s = max(account.worst_late_s, late)
        if late < 0.0:
            self._sleep(-late)
        elif late > self._period_s:
            account.missed += 1
        if late > GIVE_UP_S:
            self._start_s += late
            account.slipped_s += late


def teleop(
    scenario: Scenario,
    out: Path,
    *,
    gamepad: bool = False,
    rerun: bool = False,
    say: Callable[[str], None] = print,
) -> dict:
    """Run a scenario with a person at its live operators, into a run folder.

    Args:
        scenario: At least one arm's operator is of kind `live`.
        out: Run folder.
        gamepad: Also steer with the first gamepad (needs the extra `gamepad`).
        rerun: Also stream to a rerun viewer on this machine, whenever one is there.
        say: Takes lines for the person.

    Returns:
        The summary, with `real_time` added.

    Raises:
        InputError: no arm is live, or there is no display or gamepad.
    """
    live = [arm.name for arm in scenario.arm if isinstance(arm.operator, Live)]
    if not live:
        raise InputError(
            "no arm has an operator of kind 'live'; set one: --set arm.NAME.operator.kind=live",
            file=scenario.file,
        )
    runner.begin(out)
    cell = runner.prepare(scenario, out / runner.SCENE_FOLDER)
    (out / runner.SCENARIO_FILE).write_text(scenario.to_toml(), encoding="utf-8")
    stream = Stream(cell) if rerun else None
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    mujoco.mj_kinematics(cell.model, data)
    markers = {arm.name: tool_pose(data, arm.tool_site) for arm in cell.arms if arm.name in live}
    scene_xml = out / runner.SCENE_FOLDER / runner.SCENE_FILE
    with (
        Window(scene_xml, markers, data.qpos, gamepad=gamepad) as window,
        runner.final_check(cell, out, live=True) as check,
    ):
        session = _Session(cell, window, stream, say)
        ending = runner.simulate(cell, out, watch=session.watch, check=check)
    session.pace.account.frames = window.frames
    if stream:
        stream.close()
    summary = runner.conclude(cell, out, ending)
    summary["real_time"] = asdict(session.pace.account)
    (out / runner.SUMMARY_FILE).write_text(
        json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8"
    )
    write_replay(out)
    return summary


class _Session:
    """What happens between two ticks."""

    def __init__(
        self, cell: Cell, window: Window, stream: Stream | None, say: Callable[[str], None]
    ):
        self._cell, self._window, self._stream, self._say = cell, window, stream, say
        self.pace = Pace(cell.period_s)
        self._next_picture_s = -math.inf
        self._read = 0
        """Number of the last reading that was used."""

    def watch(self, tick: int, data: mujoco.MjData, controller: Controller) -> bool:
        """Wait for the clock, take what the person did, show the last tick; True ends the run."""
        self.pace.wait(tick)
        reading, asked = self._window.read()
        self._tune(controller, asked)
        if reading.number > self._read:
            self._read = reading.number
            for arm, (position_m, wxyz) in reading.markers.items():
                operator = controller.operators[arm]
                if isinstance(operator, LiveOperator):
                    operator.offer(Sample(tick * self._cell.period_s, position_m, wxyz))
        if tick:
            self._show(data, controller)
        return asked.quit or not self._window.is_open

    def _show(self, data: mujoco.MjData, controller: Controller) -> None:
        record, now_s = controller.record, time.perf_counter()
        if self._stream:
            self._stream.show(record, data)
        if now_s < self._next_picture_s:
            return
        self._next_picture_s = now_s + FRAME_S
        i, j = record.witness_i_m, record.witness_j_m
        self._window.show(
            Picture(
                np.array(data.qpos),
                record.time_s,
                status_text(self._cell, controller, self.pace.account),
                None if i is None or j is None else (i, j),
            )
        )

    def _tune(self, controller: Controller, asked: Steering) -> None:
        settings: dict[str, Any] = {}
        if asked.t_min_steps:
            wanted = controller.settings.t_min_s + asked.t_min_steps * T_MIN_STEP_S
            settings["t_min_s"] = max(SMALLEST_T_MIN_S, round(wanted, 6))
        if asked.criterion_steps:
            index = CRITERIA.index(controller.settings.criterion) + asked.criterion_steps
            settings["criterion"] = CRITERIA[index % len(CRITERIA)]
        if asked.entry is not None:
            settings["entry"] = asked.entry
        if settings:
            controller.tune(**settings)
            self._say(", ".join(f"{key} = {value}" for key, value in settings.items()))


def status_text(cell: Cell, controller: Controller, account: RealTime) -> tuple[str, str]:
    """Two columns of text for the screen: what, and its value."""
    record, settings = controller.record, controller.settings
    pair = record.ttc_pair
    limiting = {
        row.limiting_pair for row in record.arms.values() if row.limiting_pair is not None
    } or ({pair} if pair is not None else set())
    lines = {
        "time": f"{record.time_s:.2f} s",
        "time to collision": "-" if record.ttc_s is None else f"{min(record.ttc_s, 99.9):.2f} s",
        "mode": record.mode,
        "limiting pair": "; ".join(" - ".join(cell.pairs.names[k]) for k in sorted(limiting))
        or "-",
        "t_min (6 / 7)": f"{settings.t_min_s:.2f} s",
        "criterion (8)": settings.criterion,
        "entry (keypad 1 3 5)": settings.entry or "as in the jobs",
        "missed ticks": f"{account.missed} of {account.ticks}",
    }
    for name, row in record.arms.items():
        if row.operator_state:
            lines[f"{name} input"] = row.operator_state
        else:
            lines[f"{name} speed"] = f"{100 * row.scale:.0f} %, {row.job}"
    return "\n".join(lines), "\n".join(lines.values())


def tool_pose(data: mujoco.MjData, site: int) -> Pose:
    """Pose of a tool site, kinematics done."""
    wxyz = np.empty(4)
    mujoco.mju_mat2Quat(wxyz, data.site_xmat[site])
    return data.site_xpos[site].copy(), wxyz
