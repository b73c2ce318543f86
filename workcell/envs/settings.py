"""What an environment is made from, refused at once where it makes no sense."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

from workcell.control.finite import at_least_zero, positive
from workcell.errors import InputError, did_you_mean
from workcell.scenario import Scenario, load

Action = Literal["twist", "joints"]
ACTIONS: tuple[Action, ...] = ("twist", "joints")


@dataclass(frozen=True)
class RewardWeights:
    """Weights of the reward; docs/environments.md has the formula."""

    distance_per_m_s: float = 1.0
    """For every second a metre away from the goal, subtracted."""
    near_per_s: float = 1.0
    """For every second at no distance at all from something, subtracted; less the farther, none beyond `near_m`."""
    near_m: float = 0.1
    """Distance from which nearness costs nothing, m."""
    contact: float = 10.0
    """For a contact, subtracted once; it ends the episode."""
    arrival: float = 1.0
    """For the arrival at the goal, added once; it ends the episode."""


@dataclass(frozen=True)
class EnvSettings:
    """One environment."""

    scenario: str | Path | Scenario = "planar_crossing"
    """Name, path or scenario."""
    arm: str | None = None
    """Who acts; None: the first support arm, else the first arm."""
    action: Action = "twist"
    """`twist` of the tool in the world, or velocities of the `joints`."""
    tool_speed_m_s: float = 0.25
    """Largest of each component of a twist's linear part."""
    tool_turn_rad_s: float = 1.0
    """Largest of each component of its angular part."""
    step_s: float = 0.1
    """Time between two actions, whole ticks."""
    time_limit_s: float | None = None
    """Length of an episode; None: the scenario's."""
    arrived_m: float = 0.02
    """Distance from the goal at which the tool has arrived."""
    vary: bool = False
    """Whether every episode draws another variation from the scenario's `[vary]`."""
    seed: int = 0
    """Of all draws."""
    overrides: tuple[str, ...] = ("check.enabled=false",)
    """Of the scenario, as after `--set`. The final check costs a process and a second an episode; it is off."""
    out: str | Path | None = None
    """Run folder of the first episode, of which each further one adds `_2`, `_3`, ... to be replayed; None keeps nothing."""
    reward: RewardWeights = field(default_factory=RewardWeights)

    def __post_init__(self) -> None:
        for name in ("tool_speed_m_s", "tool_turn_rad_s", "step_s", "arrived_m"):
            positive(name, getattr(self, name))
        if self.time_limit_s is not None:
            positive("time_limit_s", self.time_limit_s)
        if self.action not in ACTIONS:
            raise InputError(f"action is {self.action!r}; allowed: {', '.join(ACTIONS)}")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            raise InputError(f"seed is {self.seed!r}; allowed is an integer >= 0")
        for each in fields(self.reward):
            at_least_zero(f"reward.{each.name}", getattr(self.reward, each.name))
        positive("reward.near_m", self.reward.near_m)
        if self.vary and self.out is not None:
            raise InputError("out: episodes that vary are not kept; drop one of vary and out")

    def read(self) -> Scenario:
        """The scenario.

        Raises:
            InputError: It cannot be read, or an episode of whole ticks and steps does not fit.
        """
        if isinstance(self.scenario, Scenario):
            found = self.scenario
        else:
            found = load(self.scenario, self.overrides)
        period_s = found.simulation.period_s
        if (
            abs(self.step_s / period_s - round(self.step_s / period_s)) > 1e-6
            or self.step_s < period_s
        ):
            raise InputError(
                f"step_s is {self.step_s:g}; allowed are multiples of simulation.period_s = {period_s:g}"
            )
        return found

    def who(self, scenario: Scenario) -> str:
        """Name of the arm that acts.

        Raises:
            InputError: There is no such arm.
        """
        names = [arm.name for arm in scenario.arm]
        if self.arm is None:
            return next((arm.name for arm in scenario.arm if arm.job), names[0])
        if self.arm not in names:
            raise InputError(
                f"arm {self.arm!r}: unknown{did_you_mean(self.arm, names)}; allowed: {', '.join(names)}"
            )
        return self.arm
