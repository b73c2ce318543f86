"""What happens between two ticks of a live run: the clock, the person's wishes, the picture.

A run calls `watch` before every tick. It returns when it is time for the tick, and has by then handed
the person's wishes to the live operators and set what is seen.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from workcell.control import reaction
from workcell.control.controller import Controller
from workcell.control.criteria import CRITERIA
from workcell.guard.supervisor import LatchedCheck
from workcell.live import pace
from workcell.live.desk import RUNNING, Desk, Picture, Say, Tool
from workcell.live.devices import T_MIN_STEP_S, DeviceInput
from workcell.live.latency import InputLatency
from workcell.live.marker import Pose, is_short
from workcell.live.status import status
from workcell.live.stream import Stream
from workcell.motion.operators.live import LiveOperator
from workcell.motion.operators.samples import Sample
from workcell.scene.cell import Cell

PICTURE_S = 1 / 30
"""Time between two pictures that the run offers."""
AHEAD_S = 0.2
"""Time between two looks at what lies ahead of the support arms."""
IDLE_S = 0.01
"""Time between two looks at a person who has not started yet."""
SMALLEST_T_MIN_S = 0.1
"""And never below what leaves every arm room to brake; see `workcell.control.reaction`."""


@dataclass
class Minutes:
    """What the surface knows of a run and its trace does not."""

    real_time: pace.RealTime
    latency: InputLatency
    stopped: str
    takes: list[tuple[int, int]]
    """First tick, and the one after the last, of every take."""


class Sitting:
    """What happens between two ticks of one run."""

    def __init__(
        self,
        cell: Cell,
        desk: Desk,
        stream: Stream | None,
        check: LatchedCheck | None,
        live: list[str],
        say: Say,
    ):
        self._cell, self._desk, self._stream, self._check = cell, desk, stream, check
        self._live, self._say = live, say
        self._sites = {arm.name: arm.tool_site for arm in cell.arms if arm.name in live}
        self._pace = pace.Pace(cell.period_s)
        self._frames_before = desk.frames
        self._next_picture_s = self._next_ahead_s = -math.inf
        self._ahead: dict[str, np.ndarray] = {}
        self._takes: list[tuple[int, int]] = []
        self._take_from: int | None = None
        self._tick = 0
        self._stopped = ""
        needed_s = max(reaction.smallest_t_min_s(cell, arm.name) for arm in cell.arms)
        self._smallest_t_min_s = max(SMALLEST_T_MIN_S, math.ceil(1e3 * needed_s) / 1e3)
        self.wants_another = False
        """Whether the person asked for a reset."""

    def minutes(self) -> Minutes:
        """What is to be added to the run's summary."""
        account = self._pace.account
        account.frames = self._desk.frames - self._frames_before
        if self._take_from is not None:
            self._takes.append((self._take_from, self._tick))
        return Minutes(account, self._desk.latency.summary(), self._stopped, self._takes)

    def watch(self, tick: int, data: mujoco.MjData, controller: Controller) -> bool:
        """Wait for the clock, take what the person did, show the last tick; True ends the run."""
        self._tick = tick
        if tick == 0:
            self._desk.begin({arm: tool_pose(data, site) for arm, site in self._sites.items()})
        if self._desk.phase != RUNNING and self._hold(tick, data, controller):
            return True
        self._pace.wait(tick)
        if self._take(controller, tick):
            return True
        self._offer(tick, data, controller)
        self._show(tick, data, controller)
        return not self._desk.is_open

    def _hold(self, tick: int, data: mujoco.MjData, controller: Controller) -> bool:
        """Let time stand still until the person goes on; True ends the run."""
        while self._desk.phase != RUNNING:
            if self._take(controller, tick) or not self._desk.is_open:
                return True
            self._show(tick, data, controller)
            time.sleep(IDLE_S)
        self._pace.resume()
        return False

    def _offer(self, tick: int, data: mujoco.MjData, controller: Controller) -> None:
        """Hand the person's wishes to the live operators, stamped with the tick at which they come."""
        rows = controller.record.arms if tick else {}
        tools = {}
        for arm, site in self._sites.items():
            row = rows.get(arm)
            tools[arm] = Tool(
                tool_pose(data, site),
                0.0 if row is None else row.tool_speed_m_s,
                row is not None and is_short(row.tool_error_m, row.tool_error_rad),
            )
        self._desk.latency.observe(max(tool.speed_m_s for tool in tools.values()))
        for arm, (position_m, wxyz) in (self._desk.hands(tools) or {}).items():
            operator = controller.operators[arm]
            if isinstance(operator, LiveOperator):
                operator.offer(Sample(tick * self._cell.period_s, position_m, wxyz))

    def _take(self, controller: Controller, tick: int) -> bool:
        """Do what was asked for; True ends the run."""
        asked = self._desk.asked()
        self._tune(controller, asked)
        if asked.release and self._check is not None and self._check.halted:
            self._check.reset()
            self._say("the final check's stop is released")
        for _ in range(asked.record_steps):
            if self._take_from is None:
                self._take_from = tick
            else:
                self._takes.append((self._take_from, tick))
                self._take_from = None
        self.wants_another = asked.reset and not asked.quit
        return asked.quit or asked.reset

    def _show(self, tick: int, data: mujoco.MjData, controller: Controller) -> None:
        now_s = time.perf_counter()
        if self._stream and tick:
            self._stream.show(controller.record, data)
        if now_s < self._next_picture_s:
            return
        self._next_picture_s = now_s + PICTURE_S
        if tick == 0:
            self._desk.show(Picture(np.array(data.qpos), 0.0))
            return
        record, account = controller.record, self._pace.account
        if now_s >= self._next_ahead_s:
            self._next_ahead_s = now_s + AHEAD_S
            self._ahead = {arm: jobs.ahead() for arm, jobs in controller.jobs.items()}
        speed = self._pace.speed
        i, j = record.witness_i_m, record.witness_j_m
        self._desk.show(
            Picture(
                np.array(data.qpos),
                record.time_s,
                status=status(
                    self._cell,
                    controller,
                    out_of_reach=self._desk.out_of_reach,
                    halt=self._halt(),
                ),
                pace=pace.speed_words(speed),
                slow=speed < pace.HELD_SHARE,
                recording=self._take_from is not None,
                missed=f"{account.missed} of {account.ticks}",
                witness_m=None if i is None or j is None else (i, j),
                ahead_m=self._ahead,
            )
        )

    def _halt(self) -> str:
        """Why the final check has stopped the support arms; empty if it has not."""
        report = None if self._check is None else self._check.report()
        if report is None:
            return ""
        self._stopped = f"{report.state}, {report.reason}"
        return self._stopped

    def _tune(self, controller: Controller, asked: DeviceInput) -> None:
        settings: dict[str, Any] = {}
        if asked.t_min_steps:
            wanted = controller.settings.t_min_s + asked.t_min_steps * T_MIN_STEP_S
            settings["t_min_s"] = max(self._smallest_t_min_s, round(wanted, 6))
        if asked.criterion_steps:
            # The scenario's own may be a plug-in's.
            names = list(dict.fromkeys([*CRITERIA, self._cell.scenario.control.criterion]))
            index = names.index(controller.settings.criterion) + asked.criterion_steps
            settings["criterion"] = names[index % len(names)]
        if asked.entry is not None:
            settings["entry"] = asked.entry
        if settings:
            controller.tune(**settings)
            self._say(", ".join(f"{key} = {value}" for key, value in settings.items()))


def home(cell: Cell) -> mujoco.MjData:
    """Every arm at home, kinematics done."""
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    mujoco.mj_kinematics(cell.model, data)
    return data


def tool_pose(data: mujoco.MjData, site: int) -> Pose:
    """Pose of a tool site, kinematics done."""
    wxyz = np.empty(4)
    mujoco.mju_mat2Quat(wxyz, data.site_xmat[site])
    return data.site_xpos[site].copy(), wxyz
