"""Whole sessions of `workcell teleop`, without a browser: started, driven, reset, left."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.live.browser import duet_toml, served
from tests.live.panel import Panel, until
from workcell.trace.table import load

pytestmark = pytest.mark.long


def started(panel: Panel) -> None:
    panel.say("act", action="start")
    assert until(lambda: panel.hear("state")["phase"] == "running", 30.0)


def test_the_nurse_waits_the_gauge_turns_red_and_leaving_the_page_leaves_whole_runs(tmp_path):
    with served(duet_toml(tmp_path), tmp_path / "run") as run:
        panel = Panel(run.address)
        started(panel)
        seen = []

        def is_red():
            panel.hold()
            seen.append(panel.hear("state"))
            return seen[-1]["colour"] == "red"

        assert until(is_red, 60.0)
        told = {arm["name"]: arm["words"] for arm in seen[-1]["arms"]}
        assert told["surgeon"] == "follows you"
        assert "surgeon" in told["nurse"], told
        panel.say("act", action="reset")
        assert until(lambda: panel.hear("state")["phase"] == "ready", 30.0)
        started(panel)
        low_m = panel.hear("state")["hands"]["surgeon"][2]

        def is_risen():
            panel.hold("PageUp")
            state = panel.hear("state")
            panel.say("seen", frame=state["frames"])
            return state["time_s"] > 0.5 and state["hands"]["surgeon"][2] > low_m + 0.05

        assert until(is_risen, 60.0)
        panel.close()
        assert run.end() == 0, run.said
    for folder in (run.folder, tmp_path / "run_2"):
        trace, summary = load(folder), json.loads((folder / "summary.json").read_text())
        assert len(trace) > 10
        assert summary["operator_report"]["nearest"]["distance_m"] > 0.0
        assert {"recording.rrd", "operator_surgeon.csv", "replay.toml"} <= {
            path.name for path in folder.iterdir()
        }
    moved = load(tmp_path / "run_2")["surgeon.target_position_m"]
    assert np.ptp(moved, axis=0)[2] > 0.02


def test_a_session_that_is_never_started_says_so(tmp_path):
    with served(duet_toml(tmp_path), tmp_path / "run") as run:
        panel = Panel(run.address)
        panel.say("act", action="quit")
        assert panel.hear("report")["text"] == "Nothing was driven."
        panel.close()
        assert run.end() == 0, run.said
    assert "Nothing was driven." in "".join(run.said)
    assert not (tmp_path / "run" / "summary.json").exists()
