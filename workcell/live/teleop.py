"""Live tele-operation: a page or a window at one end, a run like any other behind it.

    mouse, keys, gamepad -> marker -> hand -> samples -> live operator -> controller -> trace

Time is the wall clock's, held back to one tick a period; a tick that comes late is counted and
reported. The surface draws in threads of its own, on a model of its own, so that the scene that is
simulated is the one a replay uses. A session is one run, and one more for every reset, each in a
folder of its own.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from workcell import run as runner
from workcell.control.controller import Controller
from workcell.errors import InputError
from workcell.extras import need
from workcell.guard.supervisor import LatchedCheck
from workcell.live import operator_file, pace
from workcell.live.camera import best_view, presets
from workcell.live.desk import RUNNING, Desk, Picture, Say, Tool
from workcell.live.devices import CRITERIA, T_MIN_STEP_S, DeviceInput
from workcell.live.latency import InputLatency
from workcell.live.marker import Pose, is_short
from workcell.live.report import OperatorReport, operator_report
from workcell.live.status import status
from workcell.live.stream import Stream
from workcell.motion.operators.live import LiveOperator
from workcell.motion.operators.samples import Sample
from workcell.scenario import Live, Scenario
from workcell.scene.cell import Cell

LONGEST_S = 4.0 * 3600.0
"""A session ends when the person ends it; this long is a forgotten one."""
NOT_DRIVEN = "Nothing was driven."
PICTURE_S = 1 / 30
"""Time between two pictures that the run offers."""
AHEAD_S = 0.2
"""Time between two looks at what lies ahead of the support arms."""
IDLE_S = 0.01
"""Time between two looks at a person who has not started yet."""
SMALLEST_T_MIN_S = 0.1


@dataclass(frozen=True)
class Session:
    """One run of a session, concluded."""

    folder: Path
    summary: dict[str, Any]
    report: OperatorReport


@dataclass
class _Minutes:
    """What the surface knows of a run and its trace does not."""

    real_time: pace.RealTime
    latency: InputLatency
    stopped: str
    takes: list[tuple[int, int]]
    """First tick, and the one after the last, of every take."""


@dataclass(frozen=True)
class _Attempt:
    """One run of a session, as it ended."""

    cell: Cell
    folder: Path
    ending: runner.Ending
    minutes: _Minutes


def teleop(
    scenario: Scenario,
    out: Path,
    *,
    window: bool = False,
    port: int | None = None,
    gamepad: bool = False,
    rerun: bool = False,
    asked_for: Collection[str] = (),
    say: Say = print,
) -> list[Session]:
    """Run a scenario with a person at its live operators, into a run folder.

    Args:
        scenario: At least one arm's operator is of kind `live`.
        out: Run folder of the first run; a reset adds `_2`, `_3`, ...
        window: MuJoCo's window instead of the page in a browser.
        port: Of the page; None for its default.
        gamepad: At the window, also drive with the first gamepad (needs the extra `gamepad`).
        rerun: Also stream to a rerun viewer on this machine, whenever one is there.
        asked_for: Keys of the scenario that the person has set; `simulation.period_s` is then kept even if
            this machine cannot hold it, and `simulation.duration_s` ends the run.
        say: Takes lines for the person.

    Returns:
        The runs that were started, in order, each with its summary, to which `real_time`, `input_latency` and
        `operator_report` are added.

    Raises:
        InputError: no arm is live, the port is taken, or there is no display or gamepad.
    """
    live = [arm.name for arm in scenario.arm if isinstance(arm.operator, Live)]
    if not live:
        raise InputError(
            "no arm has an operator of kind 'live'; set one: --set arm.NAME.operator.kind=live",
            file=scenario.file,
        )
    if window:
        from workcell.live.window import require_display

        require_display()
    choice = pace.choose_period(scenario, keep="simulation.period_s" in asked_for)
    say(choice.said)
    scenario = choice.scenario
    if "simulation.duration_s" not in asked_for:
        scenario = _open_ended(scenario)
    cell = _prepare(scenario, out)
    attempts: list[_Attempt] = []
    with _surface(cell, out, live, window=window, port=port, gamepad=gamepad, say=say) as desk:
        stream = Stream(cell) if rerun else None
        again = True
        while again:
            folder = out if not attempts else out.with_name(f"{out.name}_{len(attempts) + 1}")
            if attempts:
                cell = _prepare(scenario, folder)
            attempt, again = _attempt(cell, folder, desk, stream, live, say)
            attempts.append(attempt)
        if stream:
            stream.close()
        # A run that was never started leaves its scenario and scene, and nothing to sum up.
        sessions = [_conclude(attempt, live) for attempt in attempts if attempt.ending.ticks]
        desk.conclude("\n".join(sessions[-1].report.lines()) if sessions else NOT_DRIVEN)
    return sessions


def _open_ended(scenario: Scenario) -> Scenario:
    """The same scenario for as long as a person likes; its own end is that of a script."""
    duration_s = max(LONGEST_S, scenario.simulation.duration_s)
    simulation = scenario.simulation.model_copy(update={"duration_s": duration_s})
    return scenario.model_copy(update={"simulation": simulation})


def _prepare(scenario: Scenario, folder: Path) -> Cell:
    """A run folder that is begun, and the cell of its run."""
    runner.begin(folder)
    cell = runner.prepare(scenario, folder / runner.SCENE_FOLDER)
    (folder / runner.SCENARIO_FILE).write_text(scenario.to_toml(), encoding="utf-8")
    return cell


@contextmanager
def _surface(
    cell: Cell,
    out: Path,
    live: list[str],
    *,
    window: bool,
    port: int | None,
    gamepad: bool,
    say: Say,
) -> Iterator[Desk]:
    """The page or the window, open while the context lasts."""
    data = _home(cell)
    scene_xml = out / runner.SCENE_FOLDER / runner.SCENE_FILE
    poses = {arm.name: tool_pose(data, arm.tool_site) for arm in cell.arms if arm.name in live}
    view = best_view(cell, data, cell.scenario.view)
    if window:
        from workcell.live.window import Window

        with Window(scene_xml, poses, data.qpos, view, gamepad=gamepad) as desk:
            yield desk
        return
    if gamepad:
        raise InputError("--gamepad: belongs to --window; the page reads a gamepad by itself")
    for module in ("viser", "mjviser"):
        need(module, extra="live", what="the page of `workcell teleop`, unlike --window,")
    from workcell.live.page import Page

    options = {} if port is None else {"port": port}
    title = f"workcell: {cell.scenario.name}"
    with Page(scene_xml, poses, presets(view), title=title, say=say, **options) as desk:
        yield desk


def _attempt(
    cell: Cell, folder: Path, desk: Desk, stream: Stream | None, live: list[str], say: Say
) -> tuple[_Attempt, bool]:
    """One run, and whether the person wants another."""
    with runner.final_check(cell, folder, live=True) as check:
        sitting = _Sitting(cell, desk, stream, check, live, say)
        ending = runner.simulate(cell, folder, watch=sitting.watch, check=check)
    return _Attempt(cell, folder, ending, sitting.minutes()), sitting.wants_another


def _conclude(attempt: _Attempt, live: list[str]) -> Session:
    """Summary, recording, operator's report and operator files of one run."""
    from workcell.trace.table import load

    folder, minutes = attempt.folder, attempt.minutes
    summary = runner.conclude(attempt.cell, folder, attempt.ending)
    trace = load(folder)
    report = operator_report(trace, live=live, latency=minutes.latency, stopped=minutes.stopped)
    summary |= {
        "real_time": asdict(minutes.real_time),
        "input_latency": asdict(minutes.latency),
        "operator_report": report.as_json(),
    }
    (folder / runner.SUMMARY_FILE).write_text(
        json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8"
    )
    operator_file.write_replay(folder)
    operator_file.write_takes(folder, minutes.takes)
    return Session(folder, summary, report)


class _Sitting:
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
        self.wants_another = False
        """Whether the person asked for a reset."""

    def minutes(self) -> _Minutes:
        """What is to be added to the run's summary."""
        account = self._pace.account
        account.frames = self._desk.frames - self._frames_before
        if self._take_from is not None:
            self._takes.append((self._take_from, self._tick))
        return _Minutes(account, self._desk.latency.summary(), self._stopped, self._takes)

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
            settings["t_min_s"] = max(SMALLEST_T_MIN_S, round(wanted, 6))
        if asked.criterion_steps:
            index = CRITERIA.index(controller.settings.criterion) + asked.criterion_steps
            settings["criterion"] = CRITERIA[index % len(CRITERIA)]
        if asked.entry is not None:
            settings["entry"] = asked.entry
        if settings:
            controller.tune(**settings)
            self._say(", ".join(f"{key} = {value}" for key, value in settings.items()))


def _home(cell: Cell) -> mujoco.MjData:
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
