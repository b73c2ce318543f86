"""Steering stage: which strategy steers which arm, and what happens when one cannot be used.

`[control] strategy` names the strategy of all support arms, `strategy` of an arm another one for it;
priority arms do what their operators ask. A strategy of the whole cell steers every arm. One that raises, hangs
or answers with nonsense has lost its turn for the rest of the run: the arm brakes as hard as its
joints can and stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from workcell import plugins
from workcell.control.arm import ControlledArm
from workcell.control.asking import StrategyFault, ask
from workcell.control.strategies.ttc import OperatorStrategy
from workcell.control.strategy import ArmView, CellView, StrategySetup
from workcell.control.tick import Steering
from workcell.control.watched import Watched
from workcell.guard.halt import brake
from workcell.scenario import Control
from workcell.scene.addresses import ArmAddresses
from workcell.scene.cell import Cell

FAULT = "strategy_fault"
"""Reason of an arm whose strategy has lost its turn."""


class Strategies:
    """The strategies of a cell.

    Args:
        cell: The cell.

    Raises:
        InputError: A strategy is unknown or cannot be made.
    """

    def __init__(self, cell: Cell):
        self.faults: list[str] = []
        self._cell = cell
        self._lost: set[str] = set()
        self._names = {arm.name: strategy_of(cell, arm.name) for arm in cell.arms}
        self._together: Any = None
        self._answers: dict[str, Steering] = {}
        self._settings: Control | None = None
        self._built_in: dict[str, bool] = {}
        self._each: dict[str, Any] = {}
        common = plugins.load("strategies", cell.scenario.control.strategy)
        if hasattr(common, "steer_all"):
            name = cell.scenario.control.strategy
            self._names = dict.fromkeys(self._names, name)
            self._together = self._make(cell.arms[0], name)
            return
        for arm in cell.arms:
            self._each[arm.name] = (
                self._make(arm, self._names[arm.name]) if arm.support else OperatorStrategy()
            )

    def _make(self, arm: ArmAddresses, name: str) -> Any:
        scenario = self._cell.scenario

        def setup(options: Any) -> StrategySetup:
            return StrategySetup(
                settings=scenario.control,
                period_s=self._cell.period_s,
                limits=arm,
                options=options,
                model=self._cell.model,
                pair_geoms=np.asarray(self._cell.pairs.geoms, dtype=np.intp).reshape(-1, 2),
                factor_multiplier=scenario.sabotage.factor_multiplier,
            )

        return plugins.make("strategies", name, setup, scenario.strategy.get(name))

    def begin(self, views: Mapping[str, ArmView], watched: Watched) -> None:
        """A tick begins: ask a strategy of the whole cell, if there is one."""
        if self._together is None:
            return
        view = CellView(dict(views), watched.jacobian, watched.distance_m, watched.inactive)
        try:
            self._answers = self._together.steer_all(view)
        except Exception as error:
            name = next(iter(self._names.values()))
            self._lose(list(views), f"strategy {name!r} raised {type(error).__name__}: {error}")

    def steer(self, arm: ControlledArm, view: ArmView) -> Steering:
        """The answer of the arm's strategy; braking once it has lost its turn."""
        if arm.name in self._lost:
            return braking(view, FAULT)
        name = self._names[arm.name]

        def answer() -> Steering:
            if self._together is not None:
                return self._answers[arm.name]
            return self._each[arm.name].steer(view)

        timed, pairs = not self._is_built_in(arm, name, view.settings), len(view.distance_m)
        try:
            return ask(name, arm.name, answer, n=len(view.dofs), pairs=pairs, timed=timed)
        except StrategyFault as fault:
            self._lose([arm.name], str(fault))
            return braking(view, FAULT)

    def _is_built_in(self, arm: ControlledArm, name: str, settings: Control) -> bool:
        """Whether nothing from outside answers for an arm; looked up anew when settings change."""
        if settings is not self._settings:
            self._settings, self._built_in = settings, {}
        found = self._built_in.get(arm.name)
        if found is None:
            found = self._built_in[arm.name] = plugins.is_built_in(
                "strategies", name
            ) and plugins.is_built_in("criteria", arm.criterion.name(settings))
        return found

    def _lose(self, arms: list[str], fault: str) -> None:
        self._lost.update(arms)
        self.faults.append(fault)


def strategy_of(cell: Cell, arm: str) -> str:
    """Name of the strategy of an arm."""
    settings = next(each for each in cell.scenario.arm if each.name == arm)
    return settings.strategy or cell.scenario.control.strategy


def braking(view: ArmView, reason: str) -> Steering:
    """Braking along the last motion as hard as the joints can: after the final check's halt, and without a strategy."""
    velocity = brake(view.command_rad_s, view.limits.acceleration_limit_rad_s2, view.period_s)
    return view.last._replace(
        velocity_rad_s=velocity,
        nominal_rad_s=velocity,
        clock_rate=0.0,
        scale=0.0,
        mode="halt",
        reason=reason,
        limiting_pair=None,
        ik_status="not_solved",
        attempt="",
    )
