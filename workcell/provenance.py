"""Where a trace comes from: its columns, and what is stored with it apart from the data.

Equal cells give equal metadata; what differs from run to run (when, on which machine) is the origin's.
"""

from __future__ import annotations

import json
import platform
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from workcell import __version__, plugins
from workcell.control.laws import arithmetic
from workcell.scenario import Scenario
from workcell.scenario.plugged import plugins_used
from workcell.scene import contacts
from workcell.scene.cell import Cell
from workcell.signals import Layout

PACKAGES = (
    "mujoco",
    "dm-control",
    "mink",
    "daqp",
    "rerun-sdk",
    "numpy",
    "scipy",
    "pyarrow",
)
"""Packages whose versions decide what a trace holds."""


def layout(cell: Cell) -> Layout:
    """What fixes the width of the trace's columns."""
    return Layout(
        arms=tuple(arm.name for arm in cell.arms),
        joints=tuple(cell.model.joint(j).name for j in range(cell.model.njnt)),
        nq=cell.model.nq,
        nv=cell.model.nv,
        pairs=cell.pairs.names,
    )


def metadata(cell: Cell) -> dict[str, str]:
    """Where a trace comes from: stored with it, apart from the data."""
    return {
        "scenario": cell.scenario.digest(),
        "settings": cell.scenario.model_dump_json(),
        "versions": json.dumps(versions(cell.scenario)),
        "platform": _platform(),
        "seed": str(cell.scenario.simulation.seed),
        "model_sha256": cell.digest,
        "meeting_pairs": json.dumps(contacts.meeting_pairs(cell)),
        "hands": json.dumps(contacts.hands(cell)),
        "person_pairs": json.dumps(contacts.person_pairs(cell)),
        "dofs": json.dumps({arm.name: arm.dofs.tolist() for arm in cell.arms}),
    }


def origin(cell: Cell) -> dict[str, Any]:
    """When and where a run began: apart from the trace, so that equal runs have equal traces."""
    return {
        "started_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "platform": _platform(),
        "versions": versions(cell.scenario),
        "scenario_sha256": cell.scenario.digest(),
        "model_sha256": cell.digest,
        "seed": cell.scenario.simulation.seed,
    }


def _platform() -> str:
    return f"{platform.system()} {platform.machine()} Python {platform.python_version()}"


def versions(scenario: Scenario | None = None) -> dict[str, str]:
    """Versions of everything that decides what a trace holds, and which arithmetic is used (docs/performance.md).

    Args:
        scenario: Whose plug-ins are named, too.
    """
    packages = {name: version(name) for name in PACKAGES}
    brought = {} if scenario is None else plugins.versions(plugins_used(scenario))
    return {"workcell": __version__} | packages | {"kernels": arithmetic()} | brought
