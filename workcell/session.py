"""A scenario step by step, from Python: reset, step, look, command.

    with workcell.Session("planar_crossing") as session:
        while not session.done:
            record = session.step()

A session steps the same `Loop` as `workcell run`, so that without commands its trace is the run's to the last bit.
Several sessions of one process may take turns; for work in parallel take processes.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell import run as runner
from workcell.control.commanded import Twist
from workcell.control.controller import Controller
from workcell.control.record import TickRecord
from workcell.errors import InputError, did_you_mean
from workcell.loop import SCENE_FOLDER, Loop
from workcell.motion.setpoint import Operator
from workcell.scenario import Scenario, load
from workcell.scene.cell import Cell


@dataclass(frozen=True)
class State:
    """The plant's true state."""

    time_s: float
    """Of the next tick."""
    qpos: NDArray[np.float64]
    """(nq,) joint positions, rad or m."""
    qvel: NDArray[np.float64]
    """(nv,) joint velocities, 1/s of it."""


class Session:
    """One scenario, as often as you like. Use it as a context: leaving it ends the checker and completes the trace.

    Args:
        scenario: A scenario, the name of a shipped one, or the path of a file.
        overrides: `KEY=VALUE` as after `--set`.
        out: Run folder of the first run; each further one adds `_2`, `_3`, ... None keeps nothing.

    Raises:
        InputError: The scenario cannot be run.
    """

    def __init__(
        self,
        scenario: Scenario | str | Path,
        overrides: Sequence[str] = (),
        *,
        out: Path | str | None = None,
    ):
        if isinstance(scenario, Scenario):
            if overrides:
                raise InputError(
                    "overrides go with a name or a path; this scenario is read already"
                )
            self.scenario = scenario
        else:
            self.scenario = load(scenario, tuple(overrides))
        self._out = None if out is None else Path(out)
        self._operators: dict[str, Operator] = {}
        self._runs = 0
        self._open = ExitStack()
        self._loop: Loop | None = None
        self._cell: Cell | None = None
        self.folder = self._out or Path(self._open.enter_context(tempfile.TemporaryDirectory()))
        """Of the run under way."""
        try:
            self.reset()
        except BaseException:
            self._open.close()
            raise

    # ---------------------------------------------------------------- a run's life

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def reset(self, *, seed: int | None = None) -> State:
        """Begin a new run; the one under way ends where it is.

        Args:
            seed: In the place of `simulation.seed`, from now on.

        Raises:
            InputError: The seed is not one, or the folder cannot be written to.
        """
        if seed is not None:
            self.scenario = _with_seed(self.scenario, seed)
        begun = self._loop is None or self._loop.controller.tick > 0
        self._end()
        # A run without a tick leaves its folder to the next one.
        self._runs += begun
        if self._out is not None:
            many = f"{self._out.name}_{self._runs}"
            self.folder = self._out if self._runs == 1 else self._out.with_name(many)
            self._cell = runner.start_folder(self.scenario, self.folder)
        elif self._cell is None:
            self._cell = runner.prepare(self.scenario, self.folder / SCENE_FOLDER)
        else:  # of the scene nothing depends on the seed
            self._cell = dataclasses.replace(self._cell, scenario=self.scenario)
        self._loop = Loop(self._cell, self.folder, trace=self._out is not None, exclusive=False)
        for arm, operator in self._operators.items():
            self._loop.controller.drive(arm, operator)
        return self.state

    def step(self, commands: Mapping[str, ArrayLike | Twist] | None = None) -> TickRecord:
        """One tick.

        Args:
            commands: What arms do in this tick in the place of their jobs or operators, by name: joint velocities
                (n,), 1/s times rad or m, or a tool's `Twist`. They pass the gate. The final check has the last word.

        Returns:
            The row of the trace: `record.pair_distance_m`, `record.arms["nurse"].tool_position_m`, ... (docs/trace.md).

        Raises:
            InputError: An arm is unknown, or a command has another shape or is not finite.
            ControlFault: A state, target or solution is not finite.
        """
        return self._under_way().step(commands)

    def finish(self) -> dict[str, Any]:
        """End the run, judge it and write summary and recording, as `workcell run` does.

        Returns:
            The summary.

        Raises:
            InputError: The session has no run folder, or no run is under way.
        """
        loop = self._under_way()
        if self._out is None:
            raise InputError("out: a summary needs a run folder: Session(..., out='runs/mine')")
        self._end()
        return runner.conclude(loop.cell, self.folder, loop.ending())

    def close(self) -> None:
        """End the run and the checker, complete the trace; may be called more than once."""
        self._end()
        self._open.close()

    # ---------------------------------------------------------------- what can be looked at and changed

    @property
    def cell(self) -> Cell:
        """The compiled cell: model, arms with their joints and limits, watched pairs."""
        return self._under_way().cell

    @property
    def state(self) -> State:
        """The plant's true state, a copy."""
        loop = self._under_way()
        data, time_s = loop.plant.data, loop.controller.tick * loop.cell.period_s
        return State(time_s, np.array(data.qpos), np.array(data.qvel))

    @property
    def data(self) -> mujoco.MjData:
        """The plant's data, to be drawn or looked at; whoever writes to it changes the run."""
        return self._under_way().plant.data

    @property
    def controller(self) -> Controller:
        """The controller: `jobs`, `operators`, `settings`, `tune`."""
        return self._under_way().controller

    @property
    def done(self) -> bool:
        """Whether the scenario's duration is over."""
        return self._under_way().controller.tick >= self.scenario.ticks

    def drive(self, arm: str, operator: Operator) -> None:
        """Put an operator of your own in the place of a priority arm's, in this run and those after it.

        Args:
            arm: Name of a priority arm.
            operator: Anything with `setpoint(time_s) -> Setpoint`; one that remembers something is to be made anew
                after a reset.

        Raises:
            InputError: There is no such priority arm.
        """
        names = [each.name for each in self.scenario.arm if not each.job]
        if arm not in names:
            raise InputError(
                f"arm {arm!r}: is no priority arm{did_you_mean(arm, names)}; allowed: {', '.join(names) or 'none'}"
            )
        self._operators[arm] = operator
        if self._loop is not None:
            self._loop.controller.drive(arm, operator)

    # ---------------------------------------------------------------- inside

    def _under_way(self) -> Loop:
        if self._loop is None:
            raise InputError("the run is over: reset() begins another")
        return self._loop

    def _end(self) -> None:
        loop, self._loop = self._loop, None
        if loop is not None:
            loop.close()


def _with_seed(scenario: Scenario, seed: int) -> Scenario:
    """The same scenario with another seed.

    Raises:
        InputError: It is not allowed.
    """
    changed = scenario.simulation.model_dump() | {"seed": seed}
    try:
        simulation = type(scenario.simulation).model_validate(changed)
    except ValueError as error:
        raise InputError(f"seed is {seed!r}; allowed is an integer from 0 to 2147483647") from error
    return scenario.model_copy(update={"simulation": simulation})
