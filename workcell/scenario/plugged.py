"""What a scenario takes from plug-ins: names that exist, options that their own models accept."""

from __future__ import annotations

from typing import TYPE_CHECKING

from workcell import plugins
from workcell.errors import InputError

if TYPE_CHECKING:
    from workcell.scenario.schema import Scenario


def strategies_used(scenario: Scenario) -> set[str]:
    """Names of the strategies that steer an arm of the scenario."""
    return {scenario.control.strategy, *(arm.strategy for arm in scenario.arm if arm.strategy)}


def strategy_faults(scenario: Scenario) -> list[str]:
    """Strategies that do not exist, and options that a strategy does not take; empty if there are none."""
    faults: list[str] = []
    named = [("control.strategy", scenario.control.strategy)]
    named += [(f"arm.{arm.name}.strategy", arm.strategy) for arm in scenario.arm if arm.strategy]
    named += [(f"strategy.{name}", name) for name in scenario.strategy]
    for key, name in named:
        try:
            plugins.find("strategies", name)
        except InputError as error:
            faults += [f"{key}: {fault}" for fault in error.faults]
    if not faults:
        for name, given in scenario.strategy.items():
            try:
                plugins.options("strategies", name, given)
            except InputError as error:
                faults += error.faults
    for arm in scenario.arm:
        if arm.strategy and not arm.job:
            faults.append(
                f"arm.{arm.name}.strategy: only an arm with jobs is steered by a strategy; this one follows its operator"
            )
    return faults
