"""The controller: one tick, stage by stage, from a measured state to actuator commands.

    sensing      state -> belief: distances, G, rates             sensing.py
    check        what the final check says                        guard/
    setpoints    jobs and operators -> tool targets               setpoints.py
    prediction   what each arm is predicted to do                 prediction.py
    steering     support arms by priority, then priority arms     strategy.py, strategies/
    gate         every command passes here                        passage.py
    outcome      the row of the trace                             outcome.py
    servo        joint velocities -> actuator controls            servo.py

Each stage answers with records that nothing changes (`tick.py`); what lasts from tick to tick is in
`arm.ArmMemory` and in the strategies. docs/architecture.md says where to change what.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.control import pair_assignment, prediction
from workcell.control.access import ControllerAccess
from workcell.control.arm import ControlledArm
from workcell.control.commanded import commanded
from workcell.control.outcome import outcome
from workcell.control.passage import Passage
from workcell.control.record import TickRecord
from workcell.control.setpoints import Setpoints
from workcell.control.steering import braking
from workcell.control.strategy import ArmView
from workcell.control.tick import ArmTick, Sensed, Steering
from workcell.guard.supervisor import Supervisor
from workcell.guard.verdict import Verdict
from workcell.scene.cell import Cell


class Controller(ControllerAccess):
    """Controls all arms of a cell.

    Args:
        cell: The compiled cell; the controller makes its own data and never touches the plant's.
        check: The final check, asked once a tick; None runs without it.
    """

    def __init__(self, cell: Cell, *, check: Supervisor | None = None):
        super().__init__(cell)
        self._check = check
        self._changes = sorted(cell.scenario.change, key=lambda change: change.time_s)
        self._order = [*self._support, *(arm for arm in self._arms if not arm.support)]
        self._setpoints = Setpoints(cell, self._arms, self._sensing)
        self._passage = Passage(cell, self._sensing)
        self._still = np.zeros(cell.model.nv)
        self._failure: BaseException | None = None

    @property
    def record(self) -> TickRecord:
        """The record of the last tick; raises what its tick has raised inside MuJoCo's callback."""
        if self._failure is not None:
            raise self._failure
        return super().record

    # ---------------------------------------------------------------- a tick

    def control(
        self, data: mujoco.MjData, qpos: NDArray[np.float64], qvel: NDArray[np.float64]
    ) -> None:
        """What MuJoCo's control callback does: one tick, from the measured state to actuator commands.

        Args:
            data: The plant, of which the controls are written; the servos' own encoders see its joints.
            qpos, qvel: What the controller is told of its state.
        """
        try:
            self.step(qpos, qvel, np.array(data.qpos))
            self._write(data)
        except BaseException as error:
            # MuJoCo leaves a callback that raises by a long jump, which ends the whole process if
            # the callback has called MuJoCo itself. So it waits for `record`, which is asked next.
            self._failure = error

    def step(
        self,
        qpos: NDArray[np.float64],
        qvel: NDArray[np.float64],
        encoders: NDArray[np.float64] | None = None,
    ) -> TickRecord:
        """One tick, from a measured state to a record with the commands; pure but for the controller's own memory.

        Args:
            qpos, qvel: What the controller is told of the plant's state.
            encoders: (nq,) what the final check sees: the plant, whatever the controller is told; None
                where there is no plant.

        Raises:
            ControlFault: a state, target or solution is not finite.
        """
        while self._changes and self._changes[0].time_s <= self.tick * self.cell.period_s:
            self.tune(**self._changes.pop(0).settings)
        settings = self._settings
        last = self._still if self._record is None else self._record.command_rad_s
        sensed = self._sensing.measure(self.tick, np.array(qpos), np.array(qvel), last, settings)
        seen = {arm.name: self._sensing.look_at(arm, settings) for arm in self._arms}
        verdict = self._ask(sensed, seen, sensed.told_qpos if encoders is None else encoders)
        setpoints = {arm.name: self._setpoints.follow(arm, sensed, seen) for arm in self._arms}
        for arm in self._arms:
            prediction.predict(self._sensing.watched, arm, setpoints[arm.name])
        ticks: dict[str, ArmTick] = {}
        views = {
            arm.name: ArmView(arm, sensed, seen[arm.name], setpoints[arm.name])
            for arm in self._order
        }
        self._strategies.begin(views, self._sensing.watched)
        for arm in self._order:
            view = views[arm.name]
            steering = self._steer(arm, view)
            command = self._passage.let_through(arm, view, steering)
            prediction.settle(self._sensing.watched, arm, command.velocity_rad_s)
            ticks[arm.name] = ArmTick(view.seen, view.setpoint, steering, command)
        self._record = outcome(
            sensed,
            self._arms,
            [ticks[arm.name] for arm in self._arms],
            watched=self._sensing.watched,
            holders=self.grasps.summary(),
            verdict=verdict,
        )
        for arm in self._arms:
            arm.remember(ticks[arm.name])
        self._commands = {}
        self.tick += 1
        return self._record

    # ---------------------------------------------------------------- stages that are one screen

    def _ask(
        self, sensed: Sensed, seen: dict[str, Any], encoders: NDArray[np.float64]
    ) -> Verdict | None:
        """Ask the final check whether the arms may go on."""
        if self._check is None:
            return None
        verdict = self._check.ask(sensed.tick, encoders, self.windows, self.grasps.holders)
        if self._check.halted:
            for arm in self._arms:
                if self._is_stopped(arm):
                    speed_m_s = seen[arm.name].tool_speed_m_s
                    self._check.observe(sensed.tick, arm.name, speed_m_s, sensed.qvel[arm.dofs])
        return verdict

    def _is_stopped(self, arm: ControlledArm) -> bool:
        """Whether the final check has stopped this arm."""
        if self._check is None or not self._check.halted:
            return False
        return arm.support or self.cell.scenario.check.stops_priority_arms

    def _steer(self, arm: ControlledArm, view: ArmView) -> Steering:
        """The strategy's answer; after the final check's halt, braking along the last motion as hard as the joints can."""
        if self._is_stopped(arm):
            return braking(view, "check")
        if arm.support:
            arm.constraints.meets(pair_assignment.meeting_pairs(self.cell, self.grasps, arm))
        if arm.name in self._commands:
            return commanded(arm, view, self._commands[arm.name])
        return self._strategies.steer(arm, view)

    def _write(self, data: mujoco.MjData) -> None:
        """Servo stage: the commands as the actuators' controls."""
        encoders = np.asarray(data.qpos)
        for arm in self._arms:
            if arm.servo.write(data, encoders[arm.addresses.qpos], arm.memory.command_rad_s):
                self._note(arm.name, "servo_lag")

    def _note(self, arm: str, reason: str) -> None:
        """Say in the last record why the plant will not do what was commanded, unless a reason is there already."""
        record = self.record
        row = record.arms[arm]
        row = row._replace(reason=row.reason or reason)
        self._record = record._replace(arms=record.arms | {arm: row})
