"""In which settings two resolved scenarios differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from workcell.errors import InputError
from workcell.scenario import Scenario

NOT_MOTION = ("name", "description", "expect", "vary")
"""Entries of a scenario that leave the motion as it is; two runs that differ in them can be compared."""
LENGTH = "simulation.duration_s"
"""A run of another length is compared as far as both go."""


@dataclass(frozen=True)
class SettingChange:
    """One setting in which two scenarios differ."""

    key: str
    """Dotted key; entries of lists by their name, or their place."""
    run: Any
    """What the run has; None where it has no such key."""
    reference: Any
    """What the reference has."""


def settings_changes(run: Mapping[str, Any], reference: Mapping[str, Any]) -> list[str]:
    """The settings of two resolved scenarios that differ and matter to the motion, `key run | reference`.

    Keys that one of them does not know yet count with their defaults.
    """
    return [
        f"{c.key} {'none' if c.run is None else c.run} | {'none' if c.reference is None else c.reference}"
        for c in changes_of(run, reference)
        if c.key != LENGTH
    ]


def changes_of(run: Mapping[str, Any], reference: Mapping[str, Any]) -> list[SettingChange]:
    """The same as records, the length of the run among them."""
    mine, theirs = _flat(_resolved(run)), _flat(_resolved(reference))
    return [
        SettingChange(key, mine.get(key), theirs.get(key))
        for key in sorted(set(mine) | set(theirs))
        if mine.get(key) != theirs.get(key) and key.partition(".")[0] not in NOT_MOTION
    ]


def _resolved(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """The settings with every default of today's schema; what it cannot read is compared as it stands."""
    if not settings:
        return settings
    try:
        return Scenario.model_validate(dict(settings)).model_dump(mode="json")
    except (ValueError, InputError):
        return settings


def _flat(node: Any, prefix: str = "") -> dict[str, Any]:
    """Dotted keys; entries of lists by their name, or their place."""
    if isinstance(node, Mapping):
        items = list(node.items())
    elif isinstance(node, (list, tuple)) and any(isinstance(x, Mapping) for x in node):
        items = [(x.get("name", k) if isinstance(x, Mapping) else k, x) for k, x in enumerate(node)]
    else:
        return {prefix: list(node) if isinstance(node, tuple) else node}
    flat: dict[str, Any] = {}
    for key, value in items:
        flat |= _flat(value, f"{prefix}.{key}" if prefix else str(key))
    return {key: value for key, value in flat.items() if value is not None}
