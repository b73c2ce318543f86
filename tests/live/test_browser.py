"""The live page in a real browser, with a real mouse and real keys."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest

from tests.live.browser import (
    browser,
    drag,
    duet_toml,
    hold,
    needs_browser,
    open_page,
    phase,
    pixel,
    served,
    start,
    until,
)
from workcell import run as runner
from workcell import scenario
from workcell.live.camera import best_view
from workcell.live.devices import KEY_SPEED_M_S
from workcell.live.drawing import GIZMO_M
from workcell.live.sitting import home, tool_pose
from workcell.trace.table import load

pytestmark = needs_browser


@pytest.mark.long  # counts real time, which a second worker on the same cores spoils
def test_a_wrong_token_gets_nothing_and_a_held_key_moves_the_tool_at_its_speed(tmp_path):
    with served(duet_toml(tmp_path), tmp_path / "run") as run, browser() as opened:
        stranger = opened.new_page()
        answer = stranger.goto(run.address.partition("?")[0] + "?token=guessed")
        assert answer is not None
        assert answer.status == 403
        assert "token" in stranger.inner_text("body")
        assert not stranger.query_selector("#wc")

        page = open_page(opened, run.address)
        assert run.rows() == 0  # held until somebody starts it
        assert "Ready" in page.inner_text("#wc-phase")
        start(page)
        held_s = hold(page, "ArrowDown", 1.0)
        time.sleep(1.0)
        page.keyboard.press("Digit9")
        page.wait_for_selector("#wc-report")
        assert "You drove for" in page.inner_text("#wc-report")
        assert run.end() == 0, run.said
    trace = load(run.folder)
    target = trace["surgeon.target_position_m"]
    way_m = float(np.linalg.norm(target[-1] - target[0]))
    assert way_m == pytest.approx(KEY_SPEED_M_S * held_s, abs=0.2 * KEY_SPEED_M_S)
    assert {"summary.json", "recording.rrd", "operator_surgeon.csv", "replay.toml"} <= {
        path.name for path in run.folder.iterdir()
    }
    summary = json.loads((run.folder / "summary.json").read_text())
    assert summary["real_time"]["ticks"] >= len(trace)
    assert summary["input_latency"]["count"] >= 1
    assert summary["operator_report"]["duration_s"] > 1.0
    assert "NOT as expected" not in "".join(run.said)


@pytest.fixture(scope="module")
def handover(tmp_path_factory):
    """The shipped scene, with a person who drags, drags too far, pauses, is watched, and ends."""
    folder = tmp_path_factory.mktemp("handover")
    options = ("arm.surgeon.operator.kind=live", "check.enabled=false", "simulation.period_s=0.02")
    loaded = scenario.load("handover", options)
    cell = runner.prepare(loaded, folder / "seen")
    data = home(cell)
    view = best_view(cell, data, loaded.view)
    surgeon = next(arm for arm in cell.arms if arm.name == "surgeon")
    here, _ = tool_pose(data, surgeon.tool_site)
    axes = data.site_xmat[surgeon.tool_site].reshape(3, 3)
    ahead = (view.look_at_m - view.position_m) / np.linalg.norm(view.look_at_m - view.position_m)
    # The arrow that lies most across the picture; towards the middle of the cell along it.
    axis = axes[:, int(np.argmin(np.abs(axes.T @ ahead)))]
    sign = 1.0 if float((view.look_at_m - here) @ axis) > 0.0 else -1.0
    facts = {"start": here, "axis": axis, "sign": sign}
    settings = [part for option in options for part in ("--set", option)]
    with served("handover", folder / "run", *settings) as run, browser() as opened:
        page = open_page(opened, run.address)
        watcher = open_page(opened, run.address, width=320, height=200)
        facts["watcher"] = watcher.inner_text("#wc-side")
        watcher.keyboard.press("Digit9")
        watcher.keyboard.press("Space")
        time.sleep(2.0)
        facts["after_watcher"] = page.get_attribute("#wc", "data-phase")
        watcher.close()
        time.sleep(5.0)  # until the picture is drawn and has its gizmo
        start(page)
        grip = here + 0.75 * GIZMO_M * axis
        drag(page, pixel(view, grip), pixel(view, grip + 0.2 * sign * axis))
        page.mouse.up()
        time.sleep(4.0)
        page.screenshot(path=folder / "dragged.png")
        facts["dragged"] = load(run.folder)["surgeon.tool_position_m"][-1]
        page.keyboard.press("Space")
        phase(page, "paused")
        time.sleep(1.5)
        stood = run.rows()
        time.sleep(1.5)
        facts["paused"] = (stood, run.rows())
        page.keyboard.press("Space")
        phase(page, "running")
        there = here + 0.2 * sign * axis
        grip = there + 0.75 * GIZMO_M * axis
        drag(page, pixel(view, grip), pixel(view, grip + 2.5 * sign * axis), steps=8)
        facts["red"] = until(
            lambda: "cannot reach farther" in page.inner_text("#wc-arms [data-arm=surgeon]"), 60.0
        )
        page.screenshot(path=folder / "out_of_reach.png")
        page.mouse.up()
        assert until(lambda: "cannot reach" not in page.inner_text("#wc-arms [data-arm=surgeon]"))
        time.sleep(8.0)
        page.keyboard.press("Digit9")
        page.wait_for_selector("#wc-report")
        facts["report"] = page.inner_text("#wc-report")
        facts["status"] = run.end()
    facts["trace"] = load(run.folder)
    return facts


@pytest.mark.long
def test_dragging_the_gizmo_twenty_centimetres_moves_the_tool_there(handover):
    way = handover["dragged"] - handover["start"]
    assert handover["sign"] * float(way @ handover["axis"]) == pytest.approx(0.2, abs=0.04)
    assert np.linalg.norm(way) == pytest.approx(0.2, abs=0.05)


@pytest.mark.long
def test_a_drag_out_of_reach_is_red_and_once_let_go_the_arm_settles(handover):
    assert handover["red"]
    trace = handover["trace"]
    joints = [k for k, name in enumerate(trace.metadata["joints"]) if name.startswith("surgeon/")]
    last = np.abs(trace["command_rad_s"][-25:, joints])
    assert last.max() < 0.1  # let go of, the arm stands but for its self-motion beside the nurse
    assert trace["surgeon.tool_speed_m_s"][-25:].max() < 0.01


@pytest.mark.long
def test_a_second_browser_only_watches(handover):
    assert "You watch" in handover["watcher"]
    assert "Start" not in handover["watcher"]
    assert handover["after_watcher"] == "ready"


@pytest.mark.long
def test_time_stands_still_in_a_pause(handover):
    before, after = handover["paused"]
    assert after - before <= 1
    assert before > 10


@pytest.mark.long
def test_the_end_is_an_operators_report(handover):
    assert handover["status"] == 0
    assert "short of where you wanted it" in handover["report"]
    assert "expect" not in handover["report"]


@pytest.mark.long
def test_the_nurse_waits_the_gauge_turns_red_and_closing_the_page_leaves_a_whole_run(tmp_path):
    with served(duet_toml(tmp_path), tmp_path / "run") as run, browser() as opened:
        page = open_page(opened, run.address)
        start(page)
        phase(page, "running")
        assert until(lambda: page.get_attribute("#wc", "data-colour") == "red", 60.0)
        told = page.inner_text("#wc-arms [data-arm=nurse]")
        assert "surgeon" in told or "arrived" in told, told
        assert "wc-red" in page.get_attribute("#wc-ttc", "class")
        page.keyboard.press("Backspace")
        phase(page, "ready")
        assert until(lambda: (tmp_path / "run_2").is_dir())
        start(page)
        time.sleep(1.0)
        page.close()
        assert run.end() == 0, run.said
    for folder in (run.folder, tmp_path / "run_2"):
        assert len(load(folder)) > 10
        assert json.loads((folder / "summary.json").read_text())["operator_report"]
