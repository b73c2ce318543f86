"""The page without a browser: a socket speaks as the page's script does."""

from __future__ import annotations

import json
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests import cells
from tests.live.panel import Panel, until
from workcell.live import page as module
from workcell.live.camera import best_view, presets
from workcell.live.controls import ACTIONS
from workcell.live.desk import COUNTING, PAUSED, READY, RUNNING, Picture, Tool
from workcell.live.devices import KEY_SPEED_M_S, DeviceInput
from workcell.live.page import Page
from workcell.live.sitting import home, tool_pose
from workcell.scenario import View


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    return cells.build(folder, cells.duet()), folder / "scene" / "scene.xml"


@pytest.fixture
def page(cell):
    built, scene_xml = cell
    data = home(built)
    pose = tool_pose(data, built.arms[0].tool_site)
    views = presets(best_view(built, data, View()))
    said: list[str] = []
    with Page(Path(scene_xml), {"surgeon": pose}, views, port=0, say=said.append) as page:
        page.show(Picture(np.array(data.qpos), 0.0))
        page.said, page.start = said, pose
        yield page


def tools(page: Page) -> dict[str, Tool]:
    return {"surgeon": Tool(page.start)}


def test_one_line_says_the_address_and_one_how_to_come_from_elsewhere(page):
    address, ssh = page.said
    assert address == f"open {page.address}"
    assert "token=" in address
    assert f"ssh -N -L {page._server.port}:127.0.0.1:{page._server.port}" in ssh


def test_the_first_browser_drives_the_second_watches_and_takes_over_when_it_may(page):
    driver = Panel(page.address)
    watcher = Panel(page.address)
    assert driver.hello["driver"]
    assert not watcher.hello["driver"]
    assert watcher.hello["taken"]
    watcher.say("act", action="quit")
    watcher.hold("ArrowRight")
    watcher.say("take")
    assert watcher.hear("state")["phase"] == READY
    assert not page.asked().quit
    assert page.hands(tools(page)) is None  # nobody has spoken who may
    driver.close()
    assert not watcher.hear("hello")["taken"]
    watcher.say("take")
    assert watcher.hear("hello")["driver"]
    watcher.say("act", action="quit")
    assert until(lambda: page.asked().quit)
    watcher.close()


def test_a_run_is_held_counted_down_paused_and_taken_up_again(page, monkeypatch):
    monkeypatch.setattr(module, "COUNT_S", 0.3)
    panel = Panel(page.address)
    assert page.phase == READY
    panel.say("act", action="start")
    assert until(lambda: page.phase == COUNTING, 5.0)
    time.sleep(0.5)
    assert page.phase == COUNTING  # there is no run yet; who has pressed is not asked again
    page.begin({"surgeon": page.start})
    assert until(lambda: page.phase == RUNNING, 5.0)
    panel.say("act", action="start")
    assert until(lambda: page.phase == PAUSED)
    panel.say("act", action="start")
    assert until(lambda: page.phase == RUNNING)
    panel.say("act", action="reset")
    assert until(lambda: page.phase == READY)
    panel.close()


def test_a_held_key_moves_the_hand_at_the_stated_speed_and_a_silent_driver_stands(page):
    panel = Panel(page.address)
    began_s = time.monotonic()
    while time.monotonic() < began_s + 0.8:
        panel.hold("PageUp")
        last_s, hands = time.monotonic(), page.hands(tools(page))
        time.sleep(0.01)
    rise = hands["surgeon"][0] - page.start[0]
    assert rise[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert rise[2] == pytest.approx(KEY_SPEED_M_S * (last_s - began_s), rel=0.15)
    time.sleep(module.KEYS_S + 0.1)
    page.hands(tools(page))
    stood = page.hands(tools(page))["surgeon"][0]
    time.sleep(0.1)
    assert page.hands(tools(page))["surgeon"][0] == pytest.approx(stood)
    assert until(lambda: page.hands(tools(page)) is None, module.ALIVE_S + 2.0)
    panel.close()


def test_a_stick_moves_and_nonsense_does_not(page):
    panel = Panel(page.address)
    for axes in ([float("nan")] * 6, "x", [1, 2], [None] * 6, {"a": 1}):
        panel.socket.send(json.dumps({"kind": "alive", "held": axes, "axes": axes}))
        panel.say("arm", name=axes if isinstance(axes, str) else "nobody")
        panel.say("act", action=["quit"])
        panel.say("camera", name=7)
    assert panel.hear("state")["phase"] == READY
    assert not page.asked().quit
    for _ in range(20):
        panel.hold(axes=[0, 0, 1.0, 0, 0, 0])
        page.hands(tools(page))
        time.sleep(0.02)
    assert page.hands(tools(page))["surgeon"][0][2] > page.start[0][2] + 0.01
    panel.close()


def test_an_open_clutch_keeps_the_hand_where_it_is(page):
    panel = Panel(page.address)
    for _ in range(10):
        panel.hold("PageUp", clutch=True)
        time.sleep(0.02)
        page.hands(tools(page))
    assert page._markers["surgeon"].wish[0][2] > page.start[0][2]
    assert page.hands(tools(page))["surgeon"][0] == pytest.approx(page.start[0])
    panel.hold()
    assert until(lambda: not page._markers["surgeon"].clutched)
    assert page._markers["surgeon"].wish[0] == pytest.approx(page.start[0])
    panel.close()


def test_every_action_is_on_the_page_with_its_key_and_does_something(page):
    panel = Panel(page.address)
    written = dict(panel.hello["keys"])
    for name, (_, key, code, words) in ACTIONS.items():
        assert written[key] == words
        assert panel.hello["presses"][code] == name
        if name in ("start", "follow"):
            continue
        panel.say("act", action=name)
        empty = DeviceInput()
        asked = []

        def came(asked=asked, empty=empty):
            now = page.asked()
            changed = [f for f in vars(now) if not np.array_equal(vars(now)[f], vars(empty)[f])]
            asked.extend(changed)
            return bool(asked)

        assert until(came), name
    panel.close()


def test_without_any_browser_for_long_the_session_is_over(page, monkeypatch):
    assert page.is_open  # nobody has come yet
    panel = Panel(page.address)
    panel.close()
    assert until(lambda: not page._browsers)
    assert page.is_open  # it may only be a reload
    monkeypatch.setattr(module, "GONE_S", 0.0)
    assert not page.is_open


def test_keys_move_as_the_picture_shows_it(page):
    camera = SimpleNamespace(position=np.array([2.0, 0.0, 1.0]), look_at=np.zeros(3))
    page._driver = "me"
    page._clients[0] = (SimpleNamespace(camera=camera), "me")
    right, away = page._heading()[:, 0], page._heading()[:, 1]
    assert away == pytest.approx([-1.0, 0.0, 0.0])  # the camera looks along -x
    assert right == pytest.approx([0.0, 1.0, 0.0])
    del page._clients[0]
    page._driver = None
