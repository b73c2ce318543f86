"""What a scenario takes from plug-ins: names that exist, options that their own models accept."""

from __future__ import annotations

from typing import TYPE_CHECKING

from workcell import plugins
from workcell.errors import InputError

if TYPE_CHECKING:
    from workcell.scenario.schema import Scenario


def plugins_used(scenario: Scenario) -> list[tuple[plugins.Kind, str]]:
    """Kind and name, sorted, of all that steers an arm of the scenario at some time or drives one, built in or not."""
    used: set[tuple[plugins.Kind, str]] = set()
    for kind in ("strategies", "criteria"):
        used |= {(kind, name) for name in _named(scenario, kind).values()}
    for arm in scenario.arm:
        if arm.operator is not None and arm.operator.kind == "plugin":
            used.add(("operators", arm.operator.name))
        if arm.operator is not None and arm.operator.kind == "live" and arm.operator.device:
            used.add(("devices", arm.operator.device))
    return sorted(used)


def plugin_faults(scenario: Scenario) -> list[str]:
    """Plug-ins that do not exist, and options that they do not take; empty if there are none."""
    faults: list[str] = []
    for kind in ("strategies", "criteria"):
        tables = getattr(scenario, plugins.SINGULAR[kind])
        named = _named(scenario, kind) | {
            f"{plugins.SINGULAR[kind]}.{name}": name for name in tables
        }
        for key, name in named.items():
            try:
                plugins.find(kind, name)
            except InputError as error:
                faults += [f"{key}: {fault}" for fault in error.faults]
        if faults:
            continue
        for name, given in tables.items():
            try:
                plugins.options(kind, name, given)
            except InputError as error:
                faults += error.faults
    for arm in scenario.arm:
        if arm.strategy and not arm.job:
            faults.append(
                f"arm.{arm.name}.strategy: only an arm with jobs is steered by a strategy; this one follows its operator"
            )
    return faults


def _named(scenario: Scenario, kind: plugins.Kind) -> dict[str, str]:
    """What a scenario names of a kind, by key."""
    one = plugins.SINGULAR[kind]
    named = {f"control.{one}": getattr(scenario.control, one)}
    named |= {f"arm.{arm.name}.{one}": getattr(arm, one) for arm in scenario.arm}
    if kind == "criteria":
        named |= {f"change.{k}.{one}": change.criterion for k, change in enumerate(scenario.change)}
    return {key: name for key, name in named.items() if name}
