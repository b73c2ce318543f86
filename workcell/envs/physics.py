"""A session as dm_control's physics: it is told what the arm does, and steps the loop that `workcell run` steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from dm_control.rl import control
from numpy.typing import ArrayLike, NDArray

from workcell.control.commanded import Twist
from workcell.control.record import ArmRecord, TickRecord
from workcell.envs.settings import EnvSettings
from workcell.errors import ControlFault
from workcell.scenario import Scenario
from workcell.scene.addresses import ArmAddresses
from workcell.session import Session
from workcell.study.vary import Variations

LARGEST_SEED = 2**31


class Episodes:
    """Runs of one scenario after each other, each drawn from one seed; the arms that act may be several.

    Args:
        scenario: What is run.
        vary: Whether every episode is another variation from `[vary]`.
        seed: Of all draws.
        out: Run folder of the first episode; None keeps nothing.

    Raises:
        InputError: The scenario cannot be run, or has no `[vary]` that could vary.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        vary: bool = False,
        seed: int = 0,
        out: str | Path | None = None,
    ):
        self._scenario = scenario
        self._variations = Variations(scenario) if vary else None
        self._random = np.random.default_rng(seed)
        self._record: TickRecord | None = None
        self.commands: dict[str, ArrayLike | Twist] = {}
        """By the arms' names, what they do until the next action: joint velocities (n,) or a `Twist`."""
        self.session = Session(scenario, out=out)

    @property
    def period_s(self) -> float:
        """Length of a tick."""
        return self._scenario.simulation.period_s

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

    def seed(self, seed: int) -> None:
        """Let the episodes from now on be drawn from this seed."""
        self._random = np.random.default_rng(seed)

    def reset(self) -> None:
        """Begin a new run, of another variation if that is asked for."""
        drawn = int(self._random.integers(LARGEST_SEED))
        if self._variations is not None:
            values = self._variations.draw(drawn, 0)
            self.session.close()
            self.session = Session(self._variations.scenario(values))
        self.session.reset(seed=drawn)

    def step(self, ticks: int = 1) -> None:
        """So many ticks.

        Raises:
            PhysicsError: a state, target or solution is not finite.
        """
        for _ in range(ticks):
            try:
                self._record = self.session.step(self.commands)
            except ControlFault as error:
                raise control.PhysicsError(str(error)) from error

    def close(self) -> None:
        """End the run under way."""
        self.session.close()


class SessionPhysics(control.Physics):
    """The cell as the arm sees it that acts.

    Args:
        arm: Its name.
        episodes: The runs in which it acts.
    """

    def __init__(self, arm: str, episodes: Episodes):
        self.arm, self.episodes = arm, episodes

    @classmethod
    def of(cls, settings: EnvSettings) -> SessionPhysics:
        """The physics of an environment with one arm that acts.

        Raises:
            InputError: The scenario cannot be run, or has no `[vary]` that could vary.
        """
        scenario = settings.read()
        arm = settings.who(scenario)
        runs = Episodes(scenario, vary=settings.vary, seed=settings.seed, out=settings.out)
        return cls(arm, runs)

    # ---------------------------------------------------------------- what dm_control asks for

    def set_control(self, control: Any) -> None:
        """What the arm does until the next action: joint velocities (n,) or a `Twist`."""
        self.episodes.commands[self.arm] = control

    def step(self, n_sub_steps: int = 1) -> None:
        """So many ticks.

        Raises:
            PhysicsError: a state, target or solution is not finite.
        """
        self.episodes.step(n_sub_steps)

    def time(self) -> float:
        """Simulated time, s."""
        return self.session.controller.tick * self.timestep()

    def timestep(self) -> float:
        """Length of a tick, s."""
        return self.episodes.period_s

    def reset(self) -> None:
        """Begin a new run, of another variation if that is asked for."""
        self.episodes.reset()

    def after_reset(self) -> None:
        """One tick at rest, so that there is something to observe."""
        self.rest()
        self.step()

    def rest(self) -> None:
        """The arm stands still until the next action."""
        self.set_control(np.zeros(len(self.addresses.dofs)))

    # ---------------------------------------------------------------- what a task reads

    @property
    def session(self) -> Session:
        """The run under way."""
        return self.episodes.session

    @property
    def addresses(self) -> ArmAddresses:
        """Joints and limits of the arm that acts."""
        return next(arm for arm in self.session.cell.arms if arm.name == self.arm)

    @property
    def record(self) -> TickRecord:
        """The last tick.

        Raises:
            PhysicsError: There is none: the environment has not been reset.
        """
        return self.episodes.record

    @property
    def own(self) -> ArmRecord:
        """The acting arm's part of it."""
        return self.record.arms[self.arm]

    @property
    def others(self) -> list[str]:
        """Names of all other arms, in the order of the scenario."""
        return [arm.name for arm in self.session.scenario.arm if arm.name != self.arm]

    def nearest_m(self) -> float:
        """Smallest distance of the watched pairs that the arm moves, those left out that are to meet or are in its hand."""
        pairs = self.session.controller.pairs_to_keep_apart(self.arm)
        return float(self.record.pair_distance_m[pairs].min(initial=np.inf))

    def goal_m(self) -> NDArray[np.float64]:
        """(3,) where the tool is to go: the end of a support arm's present path, else the operator's target."""
        jobs = self.session.controller.jobs.get(self.arm)
        ahead = np.empty((0, 3)) if jobs is None else jobs.ahead(2)
        return np.array(ahead[-1] if len(ahead) else self.own.target_position_m)
