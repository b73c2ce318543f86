"""A target beyond reach: the arm stretches to it, stands, says so, and comes back without a leap."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell.trace.table import load
from workcell.view.events import events_of

HOME = {
    "planar3": [1.7, 0.9, -0.6],
    "pa10": [0.0, 0.6, 0.0, 1.2, 0.0, 0.8, 0.0],
    "slider": [0.0],
}
OUT_S, BACK_S, END_S = 2.0, 5.0, 10.0
"""The hand is out at the first, sets off for home at the second, and is there OUT_S later."""
BEYOND_M = 1.0
SETTLED_RAD_S, SETTLING_S = 0.01, 2.0

ALL = [
    (model, plant, period_s)
    for model in HOME
    for plant in ("kinematic", "dynamic")
    for period_s in (0.002, 0.01, 0.02)
]
QUICK = [("planar3", "kinematic", 0.02), ("pa10", "kinematic", 0.02), ("planar3", "dynamic", 0.01)]


def alone(model: str, plant: str, period_s: float) -> dict:
    return {
        "name": "alone",
        "simulation": {"plant": plant, "period_s": period_s, "duration_s": END_S},
        "check": {"enabled": False},
        "arm": [
            {
                "name": "lead",
                "model": model,
                "home_rad": HOME[model],
                "operator": {"kind": "hold"},
            }
        ],
    }


def stretched(folder, model: str, plant: str, period_s: float):
    """The trace of a hand that goes straight away from the base, stays, and comes home."""
    content = alone(model, plant, period_s)
    cell = cells.build(folder / "home", content)
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    mujoco.mj_kinematics(cell.model, data)
    site = cell.arms[0].tool_site
    here, wxyz = data.site_xpos[site].copy(), np.empty(4)
    mujoco.mju_mat2Quat(wxyz, data.site_xmat[site])
    way = here - data.xpos[cell.model.body_rootid[cell.model.site_bodyid[site]]]
    if model == "planar3":
        way[2] = 0.0
    way *= BEYOND_M / np.linalg.norm(way)
    time_s = np.arange(0.0, END_S, 0.02)
    gone = np.clip(time_s / OUT_S, 0, 1) - np.clip((time_s - BACK_S) / OUT_S, 0, 1)
    share = gone * gone * (3.0 - 2.0 * gone)
    rows = [
        ",".join(f"{v:.9g}" for v in [t, *(here + s * way), *wxyz])
        for t, s in zip(time_s, share, strict=True)
    ]
    file = folder / "hand.csv"
    file.write_text("time_s,x_m,y_m,z_m,qw,qx,qy,qz\n" + "\n".join(rows) + "\n")
    content["arm"][0]["operator"] = {"kind": "recording", "file": str(file), "gap_s": 5.0}
    cell = runner.prepare(cells.load(folder, content), folder / "run" / runner.SCENE_FOLDER)
    assert runner.simulate(cell, folder / "run").fault is None
    return load(folder / "run"), cell


@pytest.mark.parametrize(
    ("model", "plant", "period_s"),
    [
        pytest.param(
            *case, marks=() if case in QUICK else pytest.mark.long, id="-".join(map(str, case))
        )
        for case in ALL
    ],
)
def test_it_settles_says_what_is_left_and_comes_back(tmp_path, model, plant, period_s):
    trace, cell = stretched(tmp_path, model, plant, period_s)
    time_s, command = trace["time_s"], trace["command_rad_s"]
    stands = (time_s > OUT_S + SETTLING_S) & (time_s < BACK_S)
    assert np.abs(command[stands]).max() < SETTLED_RAD_S
    assert set(trace["lead.reason"][stands]) == {"out_of_reach"}
    left = trace["lead.out_of_reach_m"][stands]
    np.testing.assert_allclose(left, trace["lead.tool_error_m"][stands], atol=2e-3)
    assert left.min() > 0.1
    # Nothing leaps on the way out, while it stands and on the way back: joints keep their limits.
    step = np.abs(np.diff(command, axis=0)).max(axis=0)
    assert (step <= cell.arms[0].acceleration_limit_rad_s2 * period_s * (1 + 1e-6) + 1e-9).all()
    at_home = time_s > END_S - 0.2
    assert np.isnan(trace["lead.out_of_reach_m"][at_home]).all()
    assert trace["lead.tool_error_m"][at_home].max() < 5e-3
    assert any("out_of_reach" in event.text for event in events_of(trace))


def test_a_hand_within_reach_is_never_out_of_it(tmp_path):
    content = alone("pa10", "kinematic", 0.02) | {"name": "within"}
    content["arm"][0]["operator"] = {
        "kind": "waypoints", "waypoints": [{"position_m": [0.55, 0.15, 0.5]}], "speed_m_s": 0.1,
    }  # fmt: skip
    content["simulation"]["duration_s"] = 3.0
    cell = cells.build(tmp_path, content)
    runner.simulate(cell, tmp_path)
    assert np.isnan(load(tmp_path)["lead.out_of_reach_m"]).all()
