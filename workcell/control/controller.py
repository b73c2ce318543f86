"""The controller: one object, one tick at a time, the stages of a tick from top to bottom.

    measure    state -> the controller's own belief: witness points, distances, G, rates
    follow     operators and jobs -> wanted tool poses
    plan       priority arms: the motion their operators ask for
    steer      support arms, by priority: inverse kinematics, then the factor that keeps t >= t_min
    give_way   priority arms: self-motion, once every other velocity is settled
    judge      the commanded time to collision, modes and reasons

`control` is MuJoCo's control callback; only the measured state comes in through it and only
actuator commands go out. An arm driven by jobs is a support arm: it is scaled. An arm driven by an
operator has priority: it is not, and its tool never gives way to the null space. What the pairs
allow to an arm is worked out in `share.py`.
"""

from __future__ import annotations

import math
from typing import Any

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.control import sharing
from workcell.control.arm import ControlledArm
from workcell.control.compiled import CompiledWatched
from workcell.control.criteria import NullspaceObjective
from workcell.control.finite import all_finite
from workcell.control.grasp import Grasps
from workcell.control.ik import IkSolution
from workcell.control.kernels.library import kernels
from workcell.control.proximity import PairGeometry
from workcell.control.record import ArmRecord, TickRecord
from workcell.control.second_order import second_order
from workcell.control.share import TASK_SLACK_M_S, Watched
from workcell.errors import ControlFault
from workcell.guard.halt import brake
from workcell.guard.supervisor import Supervisor
from workcell.motion.jobs import Instrument, JobSequence, Surroundings
from workcell.motion.path import standing
from workcell.motion.setpoint import Operator
from workcell.scenario import Control
from workcell.scene.addresses import InstrumentAddresses
from workcell.scene.cell import Cell

SELF_MOTION_RAD_S = 0.01
"""Joint speed beyond the tool task's own from which the mode is called self_motion; chosen as what a person notices."""
LEAVING_FACTOR = 2.0
"""An arm that could go this many times faster before any pair limited it is leaving: its factor need not rise slowly."""
REJOIN_M = 0.02
"""Off its path by more than this, after giving way, an arm first comes back before the path's clock goes on.
A retreat does not: what it has to come back to is what it is to get away from."""
ELBOW_PUSH = 0.25
"""Strength of the push to one side; chosen so that the elbow swings at about 0.5 rad/s at the default criterion gain."""
FIXED_ELBOW_M2 = 1e-6
"""Square of the lever (1 mm) below which no self-motion moves the elbow sideways."""
_SITE = mujoco.mjtObj.mjOBJ_SITE
MODES = ("run", "self_motion", "scale", "yield", "hold", "halt", "stop")
"""Rungs in rising order of severity; the cell's mode is its most severe arm's."""


class Controller:
    """Controls all arms of a cell.

    Args:
        cell: The compiled cell; the controller makes its own data and never touches the plant's.
        check: The final check, asked once a tick; None runs without it.
    """

    def __init__(self, cell: Cell, *, check: Supervisor | None = None):
        self.cell = cell
        self._check = check
        self.tick = 0
        self._dt = cell.period_s
        self._settings: Control = cell.scenario.control
        self._changes = sorted(cell.scenario.change, key=lambda change: change.time_s)
        self._belief = mink.Configuration(cell.model)
        cell.place_home(self._belief.data)
        self._belief.update()
        # MuJoCo's arrays never move; asking for them anew each tick takes as long as using them.
        self._site_xpos, self._site_xmat = self._belief.data.site_xpos, self._belief.data.site_xmat
        self._twist = np.empty(6)
        self._geometry = PairGeometry(
            cell.model, [tuple(pair) for pair in cell.pairs.geoms], cell.sensor_adr
        )
        self.grasps = Grasps(cell, self._belief.data)
        self._arms = [ControlledArm(cell, addresses, self._belief) for addresses in cell.arms]
        self._base_position_m = {arm.addresses.name: arm.base_position_m for arm in self._arms}
        self._priority = [arm for arm in self._arms if not arm.support]
        self._support = sorted(
            (arm for arm in self._arms if arm.support), key=lambda arm: arm.addresses.priority
        )
        self._watched = _watched(cell)
        self._share_pairs()
        self._keeps_rule = cell.scenario.sabotage.factor_multiplier == 1.0  # else it would mend it
        self._record: TickRecord | None = None
        self._failure: BaseException | None = None

    @property
    def operators(self) -> dict[str, Operator]:
        """The operators by the name of their arm."""
        return {arm.addresses.name: arm.operator for arm in self._arms if arm.operator is not None}

    @property
    def jobs(self) -> dict[str, JobSequence]:
        """The job sequences by the name of their arm, to be looked at only."""
        return {arm.addresses.name: arm.jobs for arm in self._arms if arm.jobs is not None}

    def drive(self, arm: str, operator: Operator) -> None:
        """Put another operator in the place of an arm's own: a replay does so for one who was live."""
        next(a for a in self._arms if a.addresses.name == arm).operator = operator

    @property
    def settings(self) -> Control:
        """The parameters in force."""
        return self._settings

    def tune(self, **settings: Any) -> None:
        """Change parameters of `[control]` from the next tick on; what may change is `scenario.Change`."""
        self._settings = self._settings.model_copy(update=settings)

    @property
    def record(self) -> TickRecord:
        """The record of the last tick; raises what its tick has raised inside MuJoCo's callback."""
        if self._failure is not None:
            raise self._failure
        if self._record is None:
            raise RuntimeError("the controller has not ticked yet")
        return self._record

    @property
    def windows(self) -> list[str]:
        """Names of the final check's exemptions that the present jobs hold open."""
        return [arm.window for arm in self._support if arm.window is not None]

    def control(
        self, data: mujoco.MjData, qpos: NDArray[np.float64], qvel: NDArray[np.float64]
    ) -> None:
        """What MuJoCo's control callback does: one tick, from the measured state to actuator commands.

        Args:
            data: The plant, of which the controls are written; the servos' own encoders see its joints.
            qpos, qvel: What the controller is told of its state.
        """
        try:
            self._act(data, qpos, qvel)
        except BaseException as error:
            # MuJoCo leaves a callback that raises by a long jump, which ends the whole process if
            # the callback has called MuJoCo itself. So it waits for `record`, which is asked next.
            self._failure = error

    def _act(
        self, data: mujoco.MjData, qpos: NDArray[np.float64], qvel: NDArray[np.float64]
    ) -> None:
        self.step(qpos, qvel)
        encoders = np.asarray(data.qpos)
        for arm in self._arms:
            if arm.servo.write(data, encoders[arm.addresses.qpos], arm.command_rad_s):
                record = self.record.arms[arm.addresses.name]
                record.reason = record.reason or "servo_lag"

    def step(self, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> TickRecord:
        """One tick, from a measured state to a record with the commands; pure but for the controller's own memory.

        Raises:
            ControlFault: a state, target or solution is not finite.
        """
        while self._changes and self._changes[0].time_s <= self.tick * self._dt:
            self.tune(**self._changes.pop(0).settings)
        record = self._measure(np.array(qpos), np.array(qvel))
        self._ask(record)
        self._follow(record)
        self._plan()
        for arm in self._support:
            self._steer(arm, record)
            self._count(arm)
        for arm in self._priority:
            self._give_way(arm, record)
            self._count(arm)
        self._judge(record)
        self._record = record
        self.tick += 1
        return record

    # ---------------------------------------------------------------- stages of a tick

    def _measure(self, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> TickRecord:
        self._finite(qpos, "qpos, the measured joint positions")
        self._finite(qvel, "qvel, the measured joint velocities")
        belief, model, watched = self._belief, self.cell.model, self._watched
        belief.data.qvel[:] = qvel
        belief.update(qpos)
        mujoco.mj_comVel(model, belief.data)
        mujoco.mj_sensorPos(model, belief.data)
        proximity = self._geometry.measure(belief.data, kept=True)
        watched.take(proximity, self.grasps.fold(belief.data, proximity.jacobian))
        watched.accel_m_s2 = None
        if self._settings.order == 2:
            # Joint accelerations count as zero: nobody knows what a person will do.
            still = np.zeros(model.nv)
            watched.accel_m_s2 = second_order(
                self._geometry, belief.data, proximity, still
            ).accel_m_s2
        rates = watched.rates(qvel, watched.accel_m_s2)
        watched.rate_m_s[...] = rates.rate_m_s
        first = rates.first
        shown = first.pair if first.pair >= 0 else rates.nearest
        record = TickRecord(
            tick=self.tick,
            time_s=self.tick * self._dt,
            qpos=qpos,
            qvel=qvel,
            pair_distance_m=watched.distance_m.copy(),
            pair_rate_m_s=rates.rate_m_s,
            t_min_s=self._settings.t_min_s,
            criterion=self._settings.criterion,
            entry=self._settings.entry,
            closest_pair=rates.nearest,
            ttc_s=_or_none(first.ttc_s),
            ttc_pair=None if first.pair < 0 else first.pair,
            witness_i_m=None if shown is None else proximity.surface_i_m[shown].copy(),
            witness_j_m=None if shown is None else proximity.surface_j_m[shown].copy(),
            wanted_rad_s=np.zeros(model.nv),
            command_rad_s=np.zeros(model.nv),
        )
        for arm in self._arms:
            record.arms[arm.addresses.name] = self._look_at(arm)
        return record

    def _look_at(self, arm: ControlledArm) -> ArmRecord:
        addresses, wxyz = arm.addresses, np.empty(4)
        mujoco.mj_objectVelocity(
            self.cell.model, self._belief.data, _SITE, addresses.tool_site, self._twist, 0
        )
        mujoco.mju_mat2Quat(wxyz, self._site_xmat[addresses.tool_site])
        artc, armd = arm.share.surroundings(
            approaching=self._settings.criterion == "artc_approaching"
        )
        return ArmRecord(
            target_position_m=arm.target.position_m,
            target_wxyz=arm.target.wxyz,
            target_velocity_m_s=arm.target.velocity_m_s,
            target_turn_rad_s=arm.target.angular_velocity_rad_s,
            job="",
            path_s=0.0,
            tool_position_m=self._site_xpos[addresses.tool_site].copy(),
            tool_wxyz=wxyz,
            tool_speed_m_s=math.hypot(*self._twist[3:].tolist()),
            tool_error_m=0.0,
            tool_error_rad=0.0,
            elbow_position_m=None
            if addresses.elbow_site is None
            else self._site_xpos[addresses.elbow_site].copy(),
            artc_per_s=artc,
            armd_per_m=armd,
        )

    def _ask(self, record: TickRecord) -> None:
        """Ask the final check whether the support arms may go on."""
        if self._check is None:
            return
        verdict = self._check.ask(record.tick, record.qpos, self.windows, self.grasps.holders)
        record.check_state, record.check_distance_m = str(verdict.state), verdict.distance_m
        if self._check.halted:
            for arm in self._arms:
                if self._stops(arm):
                    row = record.arms[arm.addresses.name]
                    self._check.observe(
                        record.tick, arm.addresses.name, row.tool_speed_m_s, record.qvel[arm.dofs]
                    )

    def _stops(self, arm: ControlledArm) -> bool:
        """Whether the final check has stopped this arm."""
        if self._check is None or not self._check.halted:
            return False
        return arm.support or self.cell.scenario.check.stops_priority_arms

    def _brake(self, arm: ControlledArm, row: ArmRecord) -> None:
        """The way to rest after the final check's halt: along the last motion, as hard as the joints can."""
        arm.factor = 0.0
        arm.wanted_rad_s = arm.command_rad_s = brake(
            arm.command_rad_s, arm.addresses.acceleration_limit_rad_s2, self._dt
        )
        row.scale, row.reason, row.mode, row.ik_status = 0.0, "check", "halt", "not_solved"

    def _follow(self, record: TickRecord) -> None:
        """Advance every driver and hand its target to the inverse kinematics."""
        for arm in self._arms:
            row = record.arms[arm.addresses.name]
            if arm.jobs is not None:
                if self.tick:
                    self._advance(arm, arm.jobs, record)
                arm.target = arm.jobs.target()
                if arm.paused or arm.held:
                    arm.target = standing(arm.target.position_m, arm.target.wxyz)
                elif arm.attempt == "back_off":
                    arm.target = arm.target.reversed()
                row.job, row.path_s = arm.jobs.name, arm.jobs.clock_s
                if arm.jobs.switched:
                    # The new path starts from rest: acceleration now counts from what was really commanded.
                    arm.wanted_rad_s = arm.command_rad_s
                    if arm.jobs.began:
                        arm.ladder.restart()
                    else:
                        arm.ladder.replanned()
            elif arm.operator is not None:
                setpoint = arm.operator.setpoint(record.time_s)
                arm.target = setpoint.target
                row.job, row.path_s = setpoint.doing, record.time_s
                row.operator_state, arm.elbow_speed_m_s = setpoint.state, setpoint.elbow_speed_m_s
            self._aim(arm, row.job)
            row.target_position_m, row.target_wxyz = arm.target.position_m, arm.target.wxyz
            row.target_velocity_m_s = arm.target.velocity_m_s
            row.target_turn_rad_s = arm.target.angular_velocity_rad_s
            row.tool_error_m, row.tool_error_rad = arm.ik.tool_error
        record.holders = self.grasps.summary()

    def _aim(self, arm: ControlledArm, job: str) -> None:
        """Hand the arm's target to its inverse kinematics."""
        try:
            arm.task_rad_s = arm.ik.aim(
                self._belief,
                arm.target,
                catch_up_m_s=self._settings.catch_up_m_s if arm.support else np.inf,
                free_rotation=arm.attempt == "free_rotation"
                or (arm.jobs is not None and arm.jobs.free_rotation),
            )
        except FloatingPointError as error:
            for value in (
                arm.target.position_m,
                arm.target.wxyz,
                arm.target.velocity_m_s,
                arm.target.angular_velocity_rad_s,
            ):
                self._finite(value, f"the tool target of arm {arm.addresses.name} from {job}")
            raise ControlFault(self.tick, str(error)) from error

    def _advance(self, arm: ControlledArm, jobs: JobSequence, record: TickRecord) -> None:
        """Let an arm's jobs go on by the factor it was granted, and hand over what changes hands."""
        around = self._around(arm, record)
        tool = record.arms[arm.addresses.name].tool_position_m
        off_path = math.dist(tool.tolist(), arm.target.position_m.tolist())
        arm.held = off_path > REJOIN_M and arm.factor > 0.0 and not jobs.retreats
        jobs.advance(self._dt, 0.0 if arm.paused or arm.held else arm.factor, around)
        if self._settings.entry:
            jobs.prefer(self._settings.entry, around)
        if arm.attempt == "re_enter" and not arm.tried_entry:
            arm.tried_entry = jobs.try_another_entry(around)
        if jobs.hand_over is not None:
            if jobs.hand_over.to is None:
                self.grasps.let_go(jobs.hand_over.instrument)
            else:
                self.grasps.take(jobs.hand_over.instrument, jobs.hand_over.to, self._belief.data)
            self._share_pairs()

    def _around(self, arm: ControlledArm, record: TickRecord) -> Surroundings:
        return Surroundings(
            tool_position_m={name: row.tool_position_m for name, row in record.arms.items()},
            base_position_m=self._base_position_m,
            instruments={item.name: self._instrument(item) for item in self.cell.instruments},
            meeting_distance_m=self._meeting_distance_m(arm),
        )

    def _instrument(self, item: InstrumentAddresses) -> Instrument:
        data = self._belief.data
        return Instrument(
            data.xpos[item.body].copy(),
            item.half_length_m * data.xmat[item.body, 2::3],
            self.cell.model.body_pos[item.body],
            self.grasps.holder(item.name),
        )

    def _plan(self) -> None:
        """What others may count on: a priority arm does what its operator asks, and no self-motion that helps them."""
        for arm in self._priority:
            arm.wanted_rad_s = arm.command_rad_s
            arm.command_rad_s = arm.task_rad_s
            arm.followed_rad_s = arm.ik.followed(self._belief, arm.wanted_rad_s, arm.task_rad_s)
        for arm in self._arms:
            self._count(arm)

    def _count(self, arm: ControlledArm) -> None:
        """What other arms may count on this one to do."""
        ways, columns = self._watched.ways_rad_s, arm.columns
        if arm.support:
            ways[:, columns] = arm.command_rad_s
        else:
            ways[0, columns], ways[1, columns] = arm.command_rad_s, arm.wanted_rad_s
            ways[2, columns] = arm.followed_rad_s

    def _steer(self, arm: ControlledArm, record: TickRecord) -> None:
        """A support arm: wanted velocity, then the largest factor that keeps every time to collision."""
        row = record.arms[arm.addresses.name]
        if self._stops(arm):
            self._brake(arm, row)
            return
        solution = self._solve(arm, record)
        row.ik_status = solution.status
        wanted = arm.wanted_rad_s = solution.velocity_rad_s
        arm.share.meets(self._meeting_pairs(arm))
        allowance = arm.share.allow(wanted, arm.command_rad_s, self._dt, self._settings)
        bound = allowance.bound
        rung = arm.ladder.climb(
            pressed=allowance.pressed,
            clock_s=0.0 if arm.jobs is None else arm.jobs.progress_s,
            moving=arm.jobs is not None and arm.jobs.moving,
            out_of_reach=arm.held and bound.factor == 1.0,
        )
        arm.attempt = row.attempt = rung.attempt
        arm.paused = rung.paused
        arm.tried_entry = arm.tried_entry and rung.attempt == "re_enter"
        row.limiting_pair = int(arm.share.pairs.owned[bound.pair]) if bound.pair >= 0 else None
        if rung.yielding:
            self._yield(arm, row)
            return
        arm.command_before_rad_s = arm.command_rad_s
        by_time = self._settings.slow_down == "ttc"
        if by_time and bound.factor < 1.0 and self._is_left(arm, row.limiting_pair):
            self._slide(arm, row)
            return
        choice = arm.governor.choose(
            bound.factor, allowance.reach, leaving=bound.required >= LEAVING_FACTOR
        )
        factor = min(1.0, choice.factor * self.cell.scenario.sabotage.factor_multiplier)
        arm.command_rad_s = factor * wanted
        reason = "" if choice.limiter == "none" else choice.limiter
        if by_time and self._keeps_rule:
            factor, forced = self._keep(arm, factor, choice.limiter == "infeasible")
            reason = "other_arm" if forced else reason
        arm.factor = -factor if rung.attempt == "back_off" else factor
        row.scale = arm.factor
        if bound.factor == 0.0 and not rung.attempt and self._path_is_free(arm):
            # At d_min nothing may close, not even the last digits of a tool error. Where the path
            # itself leads away, its clock goes on: an arm that waited for its clock, and the
            # clock for the arm, would never leave.
            arm.factor = 1.0
        row.reason = "other_arm" if bound.shortfall_m_s > 0.0 else reason
        row.mode = self._mode_of_support(arm, row)
        if row.mode in ("run", "scale") and rung.impasse and not rung.attempt:
            row.mode = "hold"  # whatever was to be tried has been

    def _path_is_free(self, arm: ControlledArm) -> bool:
        """Whether no pair would limit the arm if it only moved as its target does."""
        return arm.share.is_free(arm.ik.path_rad_s, self._settings)

    def _is_left(self, arm: ControlledArm, pair: int | None) -> bool:
        """Whether an arm retreats and is held by nothing but what it has just met."""
        return (
            arm.jobs is not None and arm.jobs.retreats and pair in self._meeting_pairs(arm).tolist()
        )

    def _slide(self, arm: ControlledArm, row: ArmRecord) -> None:
        """Get away from what was met: the motion nearest to the way back that closes no pair that is too near.

        Slowing down would not do: what is drawn out of a hand passes close by its fingers.
        """
        standing = arm.share.kept(np.zeros_like(arm.wanted_rad_s), self._settings)
        arm.factor = row.scale = self._leave_path(
            arm, arm.wanted_rad_s, standing.rows, standing.needed_m_s, row
        )
        row.reason = "other_arm" if standing.allowance_m_s.min() < -TASK_SLACK_M_S else "ttc"
        row.mode = "scale"

    def _leave_path(
        self,
        arm: ControlledArm,
        preferred_rad_s: NDArray[np.float64],
        rows: NDArray[np.float64],
        needed_m_s: NDArray[np.float64],
        row: ArmRecord | None = None,
    ) -> float:
        """Command what is nearest to a preferred velocity (n,) among what gives each row (R, n) its needed rate (R,).

        Returns:
            The share of the wanted velocity that the command has, in [0, 1]; the factor goes on from there.
        """
        before, wanted = arm.command_before_rad_s, arm.wanted_rad_s
        velocity = arm.ik.evade(self._belief, before, preferred_rad_s, rows, needed_m_s)
        if velocity is None:
            velocity = brake(before, arm.addresses.acceleration_limit_rad_s2, self._dt)
            if row is not None:
                row.ik_status = "stopped"
        arm.command_rad_s = velocity
        along = float(velocity @ wanted) / max(float(wanted @ wanted), 1e-12)
        factor = min(1.0, max(0.0, along))
        arm.governor.resume(factor)
        return factor

    def _keep(self, arm: ControlledArm, factor: float, infeasible: bool) -> tuple[float, bool]:
        """Leave the path where the joints cannot slow down along it as fast as the times to collision ask.

        One joint that already brakes as hard as it can keeps the factor up for all; the others can
        still do more. The tool comes back to its path by its own correction. A pair that
        standing does not keep is for giving way to; here it may only not be closed. So, too, where the
        joints cannot follow any factor: the command is what they can reach.

        Returns:
            The share of the wanted velocity that the command has, in [0, 1]; and whether a time falls
            short all the same, for nothing but what the others do.
        """
        share, settings = arm.share, self._settings
        if not infeasible and share.keeps(arm.command_rad_s, settings):
            return factor, False
        keeping = share.kept(arm.command_rad_s, settings)
        if infeasible or keeping.needs_more.any():
            factor = self._leave_path(arm, arm.command_rad_s, keeping.rows, keeping.needed_m_s)
            keeping = share.kept(arm.command_rad_s, settings)
        if not keeping.short.any():
            share.remember()
            return factor, False
        return factor, bool(keeping.others_alone[keeping.short].all())

    def _yield(self, arm: ControlledArm, row: ArmRecord) -> None:
        """Give way: back along the path if that is enough, else so that the near pairs open.

        Times count to d_min here, so that an arm that can move fast enough is never nearer. No pair
        is brought below t_min to open another, unless the joint limits leave no other way.
        """
        share, settings = arm.share, self._settings
        rows = share.rows(share.pairs.moved)
        movable = rows.any(axis=1)  # what its own base comes near to is not in its power
        rows, pairs = rows[movable], share.pairs.moved[movable]
        gap = self._watched.distance_m[pairs] - settings.d_min_m
        needed = -gap / settings.t_min_s - share.other_m_s[pairs]
        back = _backing_factor(rows @ arm.wanted_rad_s, needed)
        preferred = np.zeros(len(arm.dofs)) if back is None else back * arm.wanted_rad_s
        velocity = arm.ik.evade(self._belief, arm.command_rad_s, preferred, rows, needed)
        if velocity is None:
            velocity = brake(arm.command_rad_s, arm.addresses.acceleration_limit_rad_s2, self._dt)
            row.ik_status = "stopped"
        arm.command_rad_s = arm.wanted_rad_s = velocity
        arm.governor.resume(0.0)
        arm.factor = row.scale = back or 0.0
        row.reason, row.mode = "other_arm", "yield"

    def _give_way(self, arm: ControlledArm, record: TickRecord) -> None:
        """A priority arm: what its operator asks, plus self-motion that endangers nothing."""
        row = record.arms[arm.addresses.name]
        if self._stops(arm):
            arm.command_rad_s = arm.wanted_rad_s
            self._brake(arm, row)
            return
        solution = self._solve(arm, record)
        row.ik_status = solution.status
        arm.wanted_rad_s = arm.command_rad_s = solution.velocity_rad_s
        beyond = np.abs(arm.command_rad_s - arm.task_rad_s).max()
        row.mode = "self_motion" if beyond > SELF_MOTION_RAD_S else "run"

    def _judge(self, record: TickRecord) -> None:
        for arm in self._arms:
            record.wanted_rad_s[arm.columns] = arm.wanted_rad_s
            record.command_rad_s[arm.columns] = arm.command_rad_s
        if not all_finite(record.command_rad_s):
            for arm in self._arms:
                self._finite(arm.command_rad_s, f"the command of arm {arm.addresses.name}")
        rates = self._watched.rates(record.command_rad_s)
        record.ttc_command_s = _or_none(rates.first.ttc_s)
        record.ttc_command_pair = None if rates.first.pair < 0 else rates.first.pair
        if rates.cause is not None:
            record.closing_cause = self._arms[rates.cause].addresses.name
        record.mode = max((row.mode for row in record.arms.values()), key=MODES.index)

    # ---------------------------------------------------------------- parts of the stages

    def _solve(self, arm: ControlledArm, record: TickRecord) -> IkSolution:
        """Inverse kinematics with the arm's criterion and the inequality on its self-motion."""
        try:
            return arm.share.solve(
                arm.wanted_rad_s, arm.task_rad_s, record.qvel, self._settings, self._push(arm)
            )
        except FloatingPointError as error:
            raise ControlFault(self.tick, str(error)) from error

    def _push(self, arm: ControlledArm) -> NullspaceObjective | None:
        """What the arm's null space is for now instead of the scenario's criterion: its elbow to one side."""
        if arm.addresses.elbow_site is None:
            return None
        if arm.attempt in ("elbow_left", "elbow_right"):
            side = 1.0 if arm.attempt == "elbow_left" else -1.0
            return _preferring(side * ELBOW_PUSH * self._elbow_row(arm))
        return None if arm.elbow_speed_m_s == 0.0 else self._elbow_swing(arm)

    def _elbow_swing(self, arm: ControlledArm) -> NullspaceObjective:
        """Swing the elbow at the speed the operator wants, as far as the tool's task leaves it free."""
        row = self._elbow_row(arm)
        tool = self._belief.get_frame_jacobian(arm.addresses.tool_site_name, "site")[:, arm.dofs]
        free = row - np.linalg.pinv(tool, rcond=1e-3) @ (tool @ row)
        mobility = float(free @ free)
        if mobility < FIXED_ELBOW_M2 or arm.ik.criterion.gain == 0.0:
            return _preferring(np.zeros_like(row))
        return _preferring(arm.elbow_speed_m_s / (arm.ik.criterion.gain * mobility) * row)

    def _elbow_row(self, arm: ControlledArm) -> NDArray[np.float64]:
        """(n,) speed of the elbow to the left, as seen from the base towards the tool, for each joint's."""
        model, data = self.cell.model, self._belief.data
        elbow = arm.addresses.elbow_site
        body = model.site_bodyid[elbow]
        base = data.xpos[model.body_rootid[body]]
        forward = data.site_xpos[arm.addresses.tool_site] - base
        left = np.array([-forward[1], forward[0], 0.0])
        left /= max(float(np.linalg.norm(left)), 1e-9)
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, data.site_xpos[elbow], body)
        return left @ jacobian[:, arm.dofs]

    def _mode_of_support(self, arm: ControlledArm, row: ArmRecord) -> str:
        jobs = arm.jobs
        if jobs is None:
            return "run"
        if jobs.arrived:
            return "halt"
        if jobs.done or row.job == "wait":
            return "hold"
        limiting = row.limiting_pair
        if limiting is not None and row.scale < 1.0:
            near = self._watched.distance_m[limiting] <= self._settings.d_min_m
            return "halt" if near else "scale"
        return "run"

    def _meeting_distance_m(self, arm: ControlledArm) -> float:
        """Smallest distance between what the arm's present job brings together."""
        pairs = self._meeting_pairs(arm)
        return float(self._watched.distance_m[pairs].min()) if len(pairs) else np.inf

    def _meeting_pairs(self, arm: ControlledArm) -> NDArray[np.intp]:
        """Pairs that the arm's present job brings together; looked for when the job or a hand changes."""
        meeting = None if arm.jobs is None else arm.jobs.meeting
        key = (meeting, self.grasps.summary())
        if arm.meeting_key != key:
            arm.meeting_key = key
            arm.meeting_pairs = sharing.meeting_pairs(self.cell, self.grasps, arm, meeting)
        return arm.meeting_pairs

    def _share_pairs(self) -> None:
        """Deal out the pairs, as the instruments are held now."""
        self._watched.silent[...] = sharing.silent_pairs(self.cell, self.grasps)
        dealt = sharing.shared_out(self.cell, self.grasps, self._arms)
        for arm, pairs in zip(self._arms, dealt, strict=True):
            arm.share = self._watched.share(arm.ik, self._belief, pairs, support=arm.support)

    def _finite(self, values: NDArray[np.float64], what: str) -> None:
        if not all_finite(values):
            raise ControlFault(self.tick, f"{what}, is not finite: {np.asarray(values).tolist()}")


def _watched(cell: Cell) -> Watched:
    """Of a cell's pairs, in compiled code where there is any."""
    found, dofs = kernels(), [arm.dofs for arm in cell.arms]
    if found is None or not len(cell.pairs):
        return Watched(len(cell.pairs), dofs, cell.model.nv)
    return CompiledWatched(found, len(cell.pairs), dofs, cell.model.nv)


def _backing_factor(own_m_s: NDArray[np.float64], needed_m_s: NDArray[np.float64]) -> float | None:
    """The mildest factor in [-1, 0] that gives every pair the rate it needs; None if there is none.

    Args:
        own_m_s: (R,) rates at factor 1.
        needed_m_s: (R,) smallest rate of each pair.
    """
    closing, opening = own_m_s < 0.0, own_m_s > 0.0
    if (needed_m_s[~closing & ~opening] > 0.0).any():
        return None
    highest = np.min(needed_m_s[closing] / own_m_s[closing], initial=0.0)
    lowest = np.max(needed_m_s[opening] / own_m_s[opening], initial=-1.0)
    return float(highest) if lowest <= highest else None


def _preferring(push: NDArray[np.float64]) -> NullspaceObjective:
    """A null space that wants nothing but this push, (n,)."""
    return NullspaceObjective(np.zeros((len(push), len(push))), -push)


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
