"""Live tele-operation: MuJoCo's passive viewer at one end, a run like any other behind it.

    mouse, keys, gamepad -> marker of the target -> samples -> live operator -> controller -> trace
    trace's present tick -> picture and text

The viewer shows a model of its own, the scene plus one draggable marker for every live arm, on data
of its own: nothing done in the window can push the simulated arms, and the scene that is simulated
is the one a replay uses. Time is the wall clock's, held back to one tick a period; a tick that comes
late is counted and reported.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import mujoco.viewer
import numpy as np

from workcell import run as runner
from workcell.control.controller import Controller
from workcell.errors import InputError
from workcell.motion.live import LiveOperator
from workcell.motion.samples import Sample
from workcell.operator_file import write_replay
from workcell.scenario import Live, Scenario
from workcell.scene.cell import Cell
from workcell.steering import CRITERIA, T_MIN_STEP_S, Keys, Steering
from workcell.stream import Stream

FRAME_S = 1 / 60
"""Time between two pictures, and between two samples: screens redraw at 60 Hz."""
GIVE_UP_S = 0.1
"""When this far behind the clock, the run goes on from where it is instead of racing to catch up."""
SMALLEST_T_MIN_S = 0.1
MARKER_RADIUS_M = 0.025
MARKER_RGBA = (0.2, 0.75, 0.35, 0.6)
_WITNESS_RGBA = np.array([0.95, 0.75, 0.1, 1.0], dtype=np.float32)
_WITNESS_WIDTH = 4.0


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
    cell = runner.prepare(scenario, out / runner.SCENE_FOLDER)
    (out / runner.SCENARIO_FILE).write_text(scenario.to_toml(), encoding="utf-8")
    stream = Stream(cell) if rerun else None
    with _Window(cell, out / runner.SCENE_FOLDER / runner.SCENE_FILE, live, gamepad) as window:
        session = _Session(cell, window, stream, say)
        ending = runner.simulate(cell, out, watch=session.watch)
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
        self, cell: Cell, window: _Window, stream: Stream | None, say: Callable[[str], None]
    ):
        self._cell, self._window, self._stream, self._say = cell, window, stream, say
        self.pace = Pace(cell.period_s)
        self._next_frame_s = 0.0

    def watch(self, tick: int, data: mujoco.MjData, controller: Controller) -> bool:
        """Wait for the clock, take what the person did, show the last tick; True ends the run."""
        if tick == 0:
            self._window.place(data, controller)
        self.pace.wait(tick)
        if self._stream and tick:
            self._stream.show(controller.record, data)
        now = time.perf_counter()
        if now < self._next_frame_s:
            return False
        self._next_frame_s = now + FRAME_S
        self.pace.account.frames += 1
        steering = self._window.frame(data, controller if tick else None, self.pace.account)
        if steering is None:
            return True
        self._tune(controller, steering)
        for arm, (position_m, wxyz) in self._window.markers().items():
            operator = controller.operators[arm]
            if isinstance(operator, LiveOperator):
                operator.offer(Sample(tick * self._cell.period_s, position_m, wxyz))
        return False

    def _tune(self, controller: Controller, steering: Steering) -> None:
        settings: dict[str, Any] = {}
        if steering.t_min_steps:
            wanted = controller.settings.t_min_s + steering.t_min_steps * T_MIN_STEP_S
            settings["t_min_s"] = max(SMALLEST_T_MIN_S, round(wanted, 6))
        if steering.next_criterion:
            index = CRITERIA.index(controller.settings.criterion)
            settings["criterion"] = CRITERIA[(index + 1) % len(CRITERIA)]
        if settings:
            controller.tune(**settings)
            self._say(", ".join(f"{key} = {value}" for key, value in settings.items()))


class _Window:
    """The viewer with its own model and data."""

    def __init__(self, cell: Cell, scene_xml: Path, live: list[str], gamepad: bool):
        spec = mujoco.MjSpec.from_file(str(scene_xml))
        for arm in live:
            body = spec.worldbody.add_body(name=marker_name(arm), mocap=True)
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=[MARKER_RADIUS_M, MARKER_RADIUS_M, 2 * MARKER_RADIUS_M],
                rgba=MARKER_RGBA,
                contype=0,
                conaffinity=0,
            )
        self._cell = cell
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._mocap = {
            arm: int(self._model.body_mocapid[self._model.body(marker_name(arm)).id])
            for arm in live
        }
        self._keys = Keys(live[0], gamepad=gamepad)
        self._handle: Any = None

    def __enter__(self) -> _Window:
        try:
            self._handle = mujoco.viewer.launch_passive(
                self._model,
                self._data,
                key_callback=self._keys.press,
                show_left_ui=False,
                show_right_ui=False,
            )
        except Exception as error:  # GLFW and MuJoCo raise what they like where there is no display
            raise InputError(
                f"the viewer cannot be opened: {error}; a display is needed (DISPLAY)"
            ) from error
        return self

    def __exit__(self, *_: object) -> None:
        self._handle.close()

    def place(self, data: mujoco.MjData, controller: Controller) -> None:
        """Put the markers where the tools start."""
        with self._handle.lock():
            self._data.qpos[:] = data.qpos
            mujoco.mj_kinematics(self._model, self._data)
            for arm, mocap in self._mocap.items():
                operator = controller.operators[arm]
                if isinstance(operator, LiveOperator):
                    self._data.mocap_pos[mocap] = operator.start.position_m
                    self._data.mocap_quat[mocap] = operator.start.wxyz

    def markers(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Pose of every live arm's marker."""
        return {
            arm: (self._data.mocap_pos[mocap].copy(), self._data.mocap_quat[mocap].copy())
            for arm, mocap in self._mocap.items()
        }

    def frame(
        self, data: mujoco.MjData, controller: Controller | None, account: RealTime
    ) -> Steering | None:
        """Show the state and take what the person did since the last picture; None when the window is closed."""
        if not self._handle.is_running():
            return None
        steering = self._keys.take(FRAME_S)
        with self._handle.lock():
            mocap = self._mocap[self._keys.arm]
            self._data.mocap_pos[mocap], self._data.mocap_quat[mocap] = steering.moved(
                self._data.mocap_pos[mocap], self._data.mocap_quat[mocap]
            )
            self._data.qpos[:] = data.qpos
            self._data.time = data.time
            # Kinematics alone: no forces, no control callback, no mouse that pushes arms.
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_camlight(self._model, self._data)
            if controller is not None:
                self._draw_witness(controller)
        if controller is not None:
            self._handle.set_texts(
                (
                    mujoco.mjtFontScale.mjFONTSCALE_150,
                    mujoco.mjtGridPos.mjGRID_TOPLEFT,
                    *status_text(self._cell, controller, account),
                )
            )
        self._handle.sync()
        return None if steering.quit else steering

    def _draw_witness(self, controller: Controller) -> None:
        scene, record = self._handle.user_scn, controller.record
        scene.ngeom = 0
        if record.witness_i_m is None or record.witness_j_m is None:
            return
        line = scene.geoms[0]
        mujoco.mjv_initGeom(
            line,
            mujoco.mjtGeom.mjGEOM_LINE,
            np.zeros(3),
            np.zeros(3),
            np.eye(3).ravel(),
            _WITNESS_RGBA,
        )
        mujoco.mjv_connector(
            line, mujoco.mjtGeom.mjGEOM_LINE, _WITNESS_WIDTH, record.witness_i_m, record.witness_j_m
        )
        scene.ngeom = 1


def marker_name(arm: str) -> str:
    """Name of the draggable body of an arm."""
    return f"target_{arm}"


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
        "missed ticks": f"{account.missed} of {account.ticks}",
    }
    for name, row in record.arms.items():
        if row.operator_state:
            lines[f"{name} input"] = row.operator_state
        else:
            lines[f"{name} speed"] = f"{100 * row.scale:.0f} %, {row.job}"
    return "\n".join(lines), "\n".join(lines.values())
