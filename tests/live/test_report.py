"""What a person is told at the end, held against traces whose answers are known."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell.live.latency import InputLatency
from workcell.live.report import EVEN, operator_report, spectral_arc_length
from workcell.motion.operators.samples import Sample
from workcell.trace.table import load

DT = 0.01


def minimum_jerk(time_s: float = 1.0) -> np.ndarray:
    """Speed of a reach from rest to rest."""
    s = np.linspace(0.0, 1.0, round(time_s / DT))
    return 30 * s**2 * (1 - s) ** 2


def test_an_even_reach_is_called_even_and_a_halting_one_is_not():
    even = minimum_jerk()
    halting = np.concatenate([minimum_jerk(0.5), np.full(10, 0.02), minimum_jerk(0.5)])
    assert spectral_arc_length(even, DT) > EVEN
    assert spectral_arc_length(halting, DT) < spectral_arc_length(even, DT) - 0.5


def test_evenness_does_not_depend_on_how_fast_or_how_long_the_reach_is():
    lengths = [spectral_arc_length(f * minimum_jerk(t), DT) for f in (0.1, 2.0) for t in (0.6, 2.0)]
    assert lengths == pytest.approx([lengths[0]] * 4, rel=0.05)


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A person who draws the tool out of reach, and whose stream stops for a while."""
    folder = tmp_path_factory.mktemp("driven")
    content = cells.duet()
    content["check"] = {"enabled": False}
    content["simulation"]["duration_s"] = 4.0
    content["arm"][0]["operator"] = {"kind": "live"}
    cell = runner.prepare(cells.load(folder, content), folder / "run" / "scene")

    def person(tick, data, controller):
        time_s = tick * cell.period_s
        start = controller.operators["surgeon"].start
        if 1.0 < time_s < 1.5:
            return  # the stream stops
        way = np.array([0.0, 0.0, min(0.3 * time_s, 0.6)])
        controller.operators["surgeon"].offer(Sample(time_s, start.position_m + way, start.wxyz))

    runner.simulate(cell, folder / "run", watch=person)
    return load(folder / "run")


def test_distance_faults_and_reach_are_those_of_the_trace(driven):
    report = operator_report(driven, live=["surgeon"], latency=InputLatency(2, 0.02, 0.03))
    meeting = {tuple(pair) for pair in driven.metadata["meeting_pairs"]}
    free = [tuple(pair) not in meeting for pair in driven.metadata["pairs"]]
    assert report.nearest.distance_m == driven["pair_distance_m"][:, free].min()
    stale = next(fault for fault in report.faults if fault.state == "stale")
    assert stale.times == 1
    assert stale.time_s == pytest.approx(0.4, abs=0.03)  # after the 0.1 s that a stream may pause
    (reach,) = report.reaches
    assert reach.farthest_m == driven["surgeon.tool_error_m"].max()
    assert reach.time_s > 0.2
    assert report.duration_s == pytest.approx(4.0)


def test_the_report_is_told_in_sentences_and_goes_into_the_summary(driven):
    report = operator_report(
        driven, live=["surgeon"], latency=InputLatency(2, 0.02, 0.03), stopped="late, no answer"
    )
    told = "\n".join(report.lines())
    for words in ("You drove for 4.0 s", "Nearest:", "stale 1 times", "short of where", "20 ms"):
        assert words in told
    assert "The final check stopped the support arms: late, no answer." in told
    assert "expect" not in told
    assert json.loads(json.dumps(report.as_json(), allow_nan=False))["duration_s"] == 4.0


class Told(dict):
    """A trace of ten ticks, written down."""

    metadata = {  # noqa: RUF012
        "arms": ["surgeon", "nurse"],
        "pairs": [["surgeon/link3_capsule", "nurse/link5_capsule"], ["nurse/tool", "rack"]],
        "meeting_pairs": [],
        "settings": {"simulation": {"period_s": 0.5}},
    }

    def __len__(self):
        return 10


def test_waits_are_told_with_their_reasons_the_longest_first():
    scale = [1.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0]
    mode = ["run", *["halt"] * 2, *["yield"] * 2, "scale", "scale", "hold", "halt", "hold"]
    still = np.zeros(10)
    trace = Told(
        {
            "time_s": 0.5 * np.arange(10),
            "pair_distance_m": np.linspace(0.5, 0.05, 20).reshape(10, 2),
            "nurse.job": np.array(["move"] * 9 + ["done"]),
            "nurse.mode": np.array(mode),
            "nurse.scale": np.array(scale),
            "nurse.reason": np.array([""] * 8 + ["check", ""]),
            "nurse.limiting_pair": np.array([-1, 0, 0, 0, 0, 1, 1, -1, -1, -1]),
            "surgeon.operator_state": np.array(["valid"] * 10),
            "surgeon.tool_error_m": still,
            "surgeon.tool_speed_m_s": still,
        }
    )
    report = operator_report(trace, live=["surgeon"], latency=InputLatency(0, None, None))
    assert [(w.time_s, w.why) for w in report.waits] == [
        (1.0, "link3 of the surgeon was in its way"),
        (1.0, "link3 of the surgeon came"),
        (0.5, "the rack was in its way"),
        (0.5, "it found no way past"),
        (0.5, "the final check had stopped it"),
    ]
    assert (report.nearest.distance_m, report.nearest.time_s) == (pytest.approx(0.05), 4.5)
    assert report.nearest.pair == "tool of the nurse – the rack"
    assert report.faults == ()
    assert report.motions[0].spectral_arc_length is None
