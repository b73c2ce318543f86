"""A session as dm_control's physics: it is told what the arm does, and steps the loop that `workcell run` steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from dm_control.rl import control
from numpy.typing import ArrayLike, NDArray

from workcell.control.commanded import Twist
from workcell.control.record import ArmRecord, TickRecord
from workcell.envs.settings import EnvSettings
from workcell.errors import ControlFault
from workcell.session import Session
from workcell.study.vary import Variations

LARGEST_SEED = 2**31


class SessionPhysics(control.Physics):
    """Steps a session.

    Args:
        settings: Of the environment.

    Raises:
        InputError: The scenario cannot be run, or has no `[vary]` that could vary.
    """

    def __init__(self, settings: EnvSettings):
        self._settings = settings
        self._scenario = settings.read()
        self.arm = settings.who(self._scenario)
        self._variations = Variations(self._scenario) if settings.vary else None
        self._random = np.random.default_rng(settings.seed)
        self._commands: Mapping[str, ArrayLike | Twist] = {}
        self._record: TickRecord | None = None
        self.session = Session(self._scenario, out=settings.out)
        self.addresses = next(arm for arm in self.session.cell.arms if arm.name == self.arm)
        """Joints and limits of the arm that acts."""

    def seed(self, seed: int) -> None:
        """Let the episodes from now on be drawn from this seed."""
        self._random = np.random.default_rng(seed)

    def set_control(self, control: Any) -> None:
        """What the arm does until the next action: joint velocities (n,) or a `Twist`."""
        self._commands = {self.arm: control}

    def step(self, n_sub_steps: int = 1) -> None:
        """So many ticks.

        Raises:
            PhysicsError: a state, target or solution is not finite.
        """
        for _ in range(n_sub_steps):
            try:
                self._record = self.session.step(self._commands)
            except ControlFault as error:
                raise control.PhysicsError(str(error)) from error

    def time(self) -> float:
        """Simulated time, s."""
        return self.session.controller.tick * self.timestep()

    def timestep(self) -> float:
        """Length of a tick, s."""
        return self._scenario.simulation.period_s

    def reset(self) -> None:
        """Begin a new run, of another variation if that is asked for."""
        drawn = int(self._random.integers(LARGEST_SEED))
        if self._variations is not None:
            values = self._variations.draw(drawn, 0)
            self.session.close()
            self.session = Session(self._variations.scenario(values))
        self.session.reset(seed=drawn)

    def after_reset(self) -> None:
        """One tick at rest, so that there is something to observe."""
        self.set_control(np.zeros(len(self.addresses.dofs)))
        self.step()

    def close(self) -> None:
        """End the run under way."""
        self.session.close()

    # ---------------------------------------------------------------- what a task reads

    @property
    def record(self) -> TickRecord:
        """The last tick.

        Raises:
            PhysicsError: There is none: the environment has not been reset.
        """
        if self._record is None:
            raise control.PhysicsError(
                "nothing has been simulated yet: reset the environment first"
            )
        return self._record

    @property
    def own(self) -> ArmRecord:
        """The acting arm's part of it."""
        return self.record.arms[self.arm]

    @property
    def others(self) -> list[str]:
        """Names of all other arms, in the order of the scenario."""
        return [arm.name for arm in self._scenario.arm if arm.name != self.arm]

    def nearest_m(self) -> float:
        """Smallest distance of the watched pairs that the arm moves, those left out that are to meet or are in its hand."""
        pairs = self.session.controller.pairs_to_keep_apart(self.arm)
        return float(self.record.pair_distance_m[pairs].min(initial=np.inf))

    def goal_m(self) -> NDArray[np.float64]:
        """(3,) where the tool is to go: the end of a support arm's present path, else the operator's target."""
        jobs = self.session.controller.jobs.get(self.arm)
        ahead = np.empty((0, 3)) if jobs is None else jobs.ahead(2)
        return np.array(ahead[-1] if len(ahead) else self.own.target_position_m)
