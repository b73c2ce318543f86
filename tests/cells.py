"""Small scenarios for tests: arms of few joints, seconds instead of minutes."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import mujoco
import tomli_w

from workcell import scenario
from workcell.control.proximity import PairGeometry
from workcell.scene import cell as scene
from workcell.scene.addresses import InstrumentAddresses

_DUET: dict[str, Any] = {
    "name": "duet",
    "simulation": {"plant": "kinematic", "duration_s": 13.0, "period_s": 0.008},
    "arm": [
        {
            "name": "surgeon",
            "model": "planar3",
            "base_position_m": [0.55, 0.0, 0.0],
            "home_rad": [2.2, 0.9, -0.6],
            "priority": 0,
            "operator": {"kind": "hold"},
        },
        {
            "name": "nurse",
            "model": "planar3",
            "base_position_m": [-0.55, 0.0, 0.0],
            "home_rad": [1.9, -0.9, -0.6],
            "priority": 1,
            "job": [
                {"kind": "meet", "arm": "surgeon", "dwell_s": 0.2},
                {"kind": "retreat"},
            ],
        },
    ],
}


def duet(**control: Any) -> dict[str, Any]:
    """Two planar arms, one of which goes to the other's tool and back; keywords go to [control]."""
    content = copy.deepcopy(_DUET)
    content["control"] = dict(control)
    return content


def tilted_duet_with_instruments() -> dict[str, Any]:
    """Two planar arms, tilted against each other so that no rods are parallel; a probe in the nurse's
    hand, a clamp on the ground."""
    content = duet()
    content["arm"][1]["base_wxyz"] = [0.98, 0.15, 0.1, (1 - 0.98**2 - 0.15**2 - 0.1**2) ** 0.5]
    content["arm"][1]["base_position_m"] = [-0.55, 0.0, 0.2]
    content["arm"][0]["home_rad"] = [1.9, 0.9, -0.6]
    content["instrument"] = [
        {"name": "probe", "held_by": "nurse"},
        {"name": "clamp", "position_m": [0.0, -0.5, 0.3], "wxyz": [0.8, 0.6, 0.0, 0.0]},
    ]
    return content


def at_home(cell: scene.Cell) -> mujoco.MjData:
    """Data of a cell at its home pose, kinematics worked out."""
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    kinematics(cell, data)
    return data


def kinematics(cell: scene.Cell, data: mujoco.MjData) -> None:
    """Frames, joint screws and distance sensors of a pose."""
    mujoco.mj_kinematics(cell.model, data)
    mujoco.mj_comPos(cell.model, data)
    mujoco.mj_sensorPos(cell.model, data)


def geometry(cell: scene.Cell) -> PairGeometry:
    """The watched pairs, read from the cell's sensors."""
    return PairGeometry(cell.model, [tuple(pair) for pair in cell.pairs.geoms], cell.sensor_adr)


def item(cell: scene.Cell, instrument: str) -> InstrumentAddresses:
    """Addresses of an instrument."""
    return next(each for each in cell.instruments if each.name == instrument)


def write(folder: Path, content: dict[str, Any]) -> Path:
    """Write a scenario file."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{content.get('name', 'cell')}.toml"
    path.write_text(tomli_w.dumps(content), encoding="utf-8")
    return path


def load(folder: Path, content: dict[str, Any], *overrides: str) -> scenario.Scenario:
    """The scenario as the command line would read it."""
    return scenario.load(write(folder, content), overrides)


def build(folder: Path, content: dict[str, Any], *overrides: str) -> scene.Cell:
    """The compiled cell."""
    return scene.build(load(folder, content, *overrides), folder / "scene")
