"""Staged motions of two planar arms, judged without a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell.judge import ContactWatch, JudgedScene
from workcell.scene.cell import Cell
from workcell.scene.compose import SCENE_FILE


@dataclass(frozen=True)
class Stage:
    """Two planar arms whose outer links are a little apart."""

    cell: Cell
    scene: JudgedScene
    qpos: np.ndarray

    def watch(self, meeting: list[tuple[str, str]] | None = None) -> ContactWatch:
        return ContactWatch(self.scene, meeting, clear_m=0.01)

    def dofs(self, arm: str) -> np.ndarray:
        return self.scene.dofs[arm]

    def turned(self, angle: float) -> np.ndarray:
        """The home configuration with the nurse turned about its base towards the surgeon."""
        qpos = self.qpos.copy()
        qpos[self.dofs("nurse")[0]] -= angle
        return qpos


def judged_scene(cell: Cell, folder: Path) -> JudgedScene:
    """The judge's own view of a cell's scene file."""
    settings = cell.scenario.model_dump(mode="json")
    dofs = {arm.name: arm.dofs.tolist() for arm in cell.arms}
    return JudgedScene(mujoco.MjModel.from_xml_path(str(folder / SCENE_FILE)), settings, dofs)


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Stage:
    folder = tmp_path_factory.mktemp("stage")
    post = {
        "name": "post",
        "shape": "box",
        "size_m": [0.05, 0.05, 0.3],
        "position_m": [-0.9, 0.0, 0.3],
    }
    cell = cells.build(folder, cells.duet() | {"obstacle": [post]})
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    return Stage(cell, judged_scene(cell, folder / "scene"), np.array(data.qpos))


@pytest.fixture(scope="module")
def touching(stage: Stage) -> np.ndarray:
    """The first of the nurse's steps towards the surgeon at which solids touch."""
    watch = stage.watch()
    for angle in np.linspace(0.0, 1.5, 600):
        watch.look(0.0, stage.turned(angle), np.zeros(6))
        if watch.contact is not None:
            return stage.turned(angle)
    raise AssertionError("the arms never touch")
