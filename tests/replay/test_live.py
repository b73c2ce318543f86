"""A run with a person at the other end, done again without one."""

import mujoco
import numpy as np

from tests import cells
from tests.replay.conftest import duet_content
from workcell import run as runner
from workcell.motion.operators.samples import Sample
from workcell.regression import replay
from workcell.regression.compare import compare
from workcell.regression.excerpt import excerpt
from workcell.regression.rows import states
from workcell.trace.table import load


def test_a_live_run_is_replayed_from_its_targets_and_settings(tmp_path):
    content = duet_content()
    content["arm"][0]["operator"] = {"kind": "live"}
    content["simulation"]["duration_s"] = 2.0
    cell = runner.prepare(cells.load(tmp_path, content), tmp_path / "run" / "scene")

    home = mujoco.MjData(cell.model)
    cell.place_home(home)
    mujoco.mj_kinematics(cell.model, home)
    start, pose = home.site_xpos[cell.arms[0].tool_site].copy(), np.empty(4)
    mujoco.mju_mat2Quat(pose, home.site_xmat[cell.arms[0].tool_site])

    def person(tick, data, controller):
        """Draws the tool aside along an arc, and asks for more time in the middle of it."""
        angle = 2.0 * tick * cell.period_s
        there = start + 0.02 * np.array([1.0 - np.cos(angle), 0.0, np.sin(angle)])
        controller.operators["surgeon"].offer(Sample(tick * cell.period_s, there, pose))
        if tick == 40:
            controller.tune(t_min_s=1.4, criterion="armd")

    runner.simulate(cell, tmp_path / "run", watch=person)
    trace = load(tmp_path / "run")
    assert np.ptp(trace["surgeon.target_position_m"], axis=0).max() > 0.01, "somebody drove"
    assert set(trace["t_min_s"]) == {1.0, 1.4}
    again = replay.open_loop(cell, states(trace), tmp_path / "again").trace
    result = compare(excerpt(again), excerpt(trace), without_plant=True)
    assert result.kind == "same", result.headline()
