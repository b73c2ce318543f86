"""The plant: steered by one controller at a time, and by nothing of it but its commands."""

from __future__ import annotations

import threading
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell.control.controller import Controller
from workcell.errors import InputError
from workcell.guard.verdict import CheckState, Verdict
from workcell.scene import cell as scene
from workcell.simulation.plant import Plant
from workcell.trace.table import load


@pytest.fixture(scope="module")
def cell(tmp_path_factory) -> scene.Cell:
    return cells.build(tmp_path_factory.mktemp("duet"), cells.duet())


def test_the_callback_is_removed_whatever_happens(cell):
    plant = Plant(cell)
    with plant.steered_by(Controller(cell)):
        assert mujoco.get_mjcb_control() is not None
    assert mujoco.get_mjcb_control() is None
    with pytest.raises(ZeroDivisionError), plant.steered_by(Controller(cell)):
        raise ZeroDivisionError
    assert mujoco.get_mjcb_control() is None


def test_a_callback_that_was_there_before_is_there_again(cell):
    def theirs(model, data):
        pass

    mujoco.set_mjcb_control(theirs)
    try:
        with Plant(cell).steered_by(Controller(cell)):
            assert mujoco.get_mjcb_control() is not theirs
        assert mujoco.get_mjcb_control() is theirs
    finally:
        mujoco.set_mjcb_control(None)


def test_other_simulations_in_the_process_are_not_steered(cell):
    controller, plant, foreign = Controller(cell), Plant(cell), mujoco.MjData(cell.model)
    cell.place_home(foreign)
    with plant.steered_by(controller):
        mujoco.mj_step(cell.model, foreign)
        assert controller.tick == 0
        assert not foreign.ctrl.any()
        mujoco.mj_step(plant.model, plant.data)
        assert controller.tick == 1
        assert plant.data.ctrl.any()


def test_a_second_simulation_at_the_same_time_is_refused_by_name(cell):
    with (
        Plant(cell).steered_by(Controller(cell)),
        pytest.raises(InputError, match="scenario duet: another simulation of this process"),
        Plant(cell).steered_by(Controller(cell)),
    ):
        pass
    with Plant(cell).steered_by(Controller(cell)):
        pass


def content() -> dict:
    found = cells.duet()
    found["simulation"]["duration_s"] = 1.6
    found["check"] = {"enabled": False}
    return found


def test_two_runs_in_threads_are_right_or_refused_and_runs_in_a_row_are_equal(tmp_path):
    """One of two threads runs as if it were alone; the other is told why not, and has written no trace."""
    folders = [tmp_path / name for name in ("alone", "first", "second")]

    def run(folder: Path) -> None:
        try:
            runner.run(cells.load(folder, content()), folder / "run")
        except InputError as error:
            refused.append((folder, str(error)))

    refused: list[tuple[Path, str]] = []
    run(folders[0])
    threads = [threading.Thread(target=run, args=(folder,)) for folder in folders[1:]]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for folder, message in refused:
        assert "duet: another simulation of this process" in message
        assert not (folder / "run" / "trace.parquet").exists()
    right = [folder for folder in folders if folder not in [each for each, _ in refused]]
    assert len(right) >= 2
    run(tmp_path / "after")
    digests = {load(folder / "run").digest() for folder in (*right, tmp_path / "after")}
    assert len(digests) == 1
    assert mujoco.get_mjcb_control() is None


def test_what_a_hand_takes_is_carried_from_where_it_truly_is(tmp_path):
    """With a late and noisy belief: the instrument keeps its true place in the hand."""
    found = content() | {"instrument": [{"name": "probe", "held_by": "nurse"}]}
    found["simulation"] |= {"latency_ticks": 3, "position_noise_rad": 1e-3}
    cell = cells.build(tmp_path, found)
    plant, controller = Plant(cell), Controller(cell)
    item, nurse = cell.instruments[0], cell.arms[1]

    def in_hand() -> np.ndarray:
        mujoco.mj_kinematics(cell.model, plant.data)
        tool = plant.data.site_xmat[nurse.tool_site].reshape(3, 3)
        return tool.T @ (plant.data.xpos[item.body] - plant.data.site_xpos[nurse.tool_site])

    before = in_hand()
    with plant.steered_by(controller):
        for _ in range(60):
            plant.step(controller)
    plant._instruments.carry(plant.data)
    np.testing.assert_allclose(in_hand(), before, atol=1e-12)


def test_the_record_has_the_true_state_and_the_final_check_sees_it(tmp_path):
    """However late and noisy the controller's belief: truth is logged, and truth is what is checked."""
    found = content()
    found["simulation"] |= {"latency_ticks": 5, "position_noise_rad": 1e-3}
    cell = cells.build(tmp_path, found)
    seen = []

    class Watching:
        halted = False

        def ask(self, tick, qpos, windows, holders):
            seen.append(qpos)
            return Verdict(CheckState.CLEAR, 0, tick, 0, 1.0, None, None, "")

        def observe(self, *_):
            raise AssertionError("nothing was halted")

    plant, controller = Plant(cell), Controller(cell, check=Watching())
    with plant.steered_by(controller):
        for _ in range(20):
            truth = np.array(plant.data.qpos), np.array(plant.data.qvel)
            record = plant.step(controller)
            np.testing.assert_array_equal(record.plant_qpos, truth[0])
            np.testing.assert_array_equal(record.plant_qvel, truth[1])
            np.testing.assert_array_equal(seen[-1], truth[0])
            assert not np.array_equal(record.qpos, truth[0])
