"""The first view shows every tool, and `[view]` has the last word."""

from __future__ import annotations

import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell import scenario
from workcell.live.camera import best_view, presets, tool_is_seen, view_from
from workcell.live.sitting import home
from workcell.scenario import View


@pytest.mark.parametrize("name", ["handover", "busy_human", "three_arms", "surgeon_sweeps"])
def test_both_tools_are_seen_from_where_the_camera_starts(tmp_path, name):
    cell = runner.prepare(scenario.load(name), tmp_path)
    data = home(cell)
    eye = best_view(cell, data, View()).position_m
    assert all(tool_is_seen(cell, data, eye, arm.tool_site) for arm in cell.arms)


def test_a_tool_behind_something_is_not_seen(tmp_path):
    content = cells.duet()
    cell = cells.build(tmp_path, content)
    data = home(cell)
    tool = data.site_xpos[cell.arms[0].tool_site]
    assert tool_is_seen(cell, data, tool + np.array([0.0, -2.0, 0.0]), cell.arms[0].tool_site)
    content["obstacle"] = [
        {
            "name": "screen",
            "shape": "box",
            "size_m": [1.0, 0.02, 1.0],
            "position_m": [float(tool[0]), float(tool[1]) - 1.0, float(tool[2])],
        }
    ]
    hidden = cells.build(tmp_path / "hidden", content)
    data = home(hidden)
    assert not tool_is_seen(
        hidden, data, tool + np.array([0.0, -2.0, 0.0]), hidden.arms[0].tool_site
    )


def test_what_the_scenario_gives_is_kept(tmp_path):
    cell = cells.build(tmp_path, cells.duet())
    view = best_view(
        cell,
        home(cell),
        View(camera_azimuth_deg=90.0, camera_elevation_deg=30.0, camera_distance_m=3.0),
    )
    expected = view_from(view.look_at_m, 90.0, 30.0, 3.0)
    assert view.position_m == pytest.approx(expected.position_m)
    assert view.position_m[1] < view.look_at_m[1]  # looks along y
    assert view.position_m[2] == pytest.approx(view.look_at_m[2] + 1.5)


def test_presets_look_at_the_same_point_from_the_same_distance(tmp_path):
    cell = cells.build(tmp_path, cells.duet())
    views = presets(best_view(cell, home(cell), View()))
    away = [np.linalg.norm(v.position_m - v.look_at_m) for v in views.values()]
    assert away == pytest.approx([away[0]] * len(away))
    assert next(iter(views)) == "best"
