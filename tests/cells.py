"""Small scenarios for tests: arms of few joints, seconds instead of minutes."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import tomli_w

from workcell import scenario
from workcell.scene import cell as scene

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
