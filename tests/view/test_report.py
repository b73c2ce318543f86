"""The report is whole, small, safe against what names may hold, and opens without a network."""

import json
import re

import numpy as np
import pytest

from workcell.errors import InputError
from workcell.view import page as pages
from workcell.view import report as reports
from workcell.view.events import events_of
from workcell.view.page import POINTS, Page, thinned

SUMMARY = {
    "scenario": "two <arms>",
    "held": False,
    "expectations": {"contact": {"wanted": "false", "measured": "true", "held": False}},
    "metrics": {"fault": None, "smallest_distance_m": 0.0123, "final_mode": "halt"},
}


@pytest.fixture(scope="module")
def text(run, tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "report.html"
    reports.report(run.trace, run.scene, SUMMARY, out, again="workcell run a.toml --set x='<b>'")
    assert out.stat().st_size < 3_000_000
    return out.read_text(encoding="utf-8")


def test_it_needs_nothing_from_a_network(text):
    without_library = re.sub(r'<script id="plotly".*?</script>', "", text, flags=re.S)
    assert not re.search(r'(src|href)="(?!data:)', without_library)
    assert not re.search(r"https?://", without_library)


def test_it_says_verdict_events_versions_and_the_command(run, text):
    assert "not as expected: contact" in text
    for event in events_of(run.trace)[:20]:
        assert event.text in text
    assert run.trace.digest() in text
    assert "workcell run a.toml --set x=&#x27;&lt;b&gt;&#x27;" in text


def test_its_curves_are_the_trace(run, text):
    (content,) = re.findall(r'data-figure="figure1">(.*?)</script>', text, flags=re.S)
    figure = json.loads(content)
    named = [line["name"] for line in figure["data"] if line["type"] == "scatter"]
    assert named.count("nurse") == named.count("surgeon") == 3
    assert {"measured", "commanded", "final check"} <= set(named)
    bars = [line for line in figure["data"] if line["type"] == "bar"]
    assert {bar["name"] for bar in bars} == {"mode run", "mode scale", "mode halt"}


def test_a_thinned_curve_keeps_its_extremes():
    values = np.sin(np.linspace(0, 60, 20_000))
    values[7777] = -3.0
    values[100:200] = np.nan
    places, shown = thinned(values, least=True)
    assert len(places) <= POINTS
    assert (np.diff(places) > 0).all()
    assert np.nanmin(shown) == -3.0
    np.testing.assert_array_equal(shown, values[places].astype(np.float32))
    _, most = thinned(-values, least=False)
    assert np.nanmax(most) == 3.0
    few = np.array([1.0, np.nan, 2.0])
    np.testing.assert_array_equal(thinned(few, least=True)[1], few.astype(np.float32))


def test_a_page_escapes_what_it_is_given():
    page = Page("<title>")
    page.text("<script>alert(1)</script>")
    page.table(["<a>"], [["<b>", "NO"]])
    content = page.write()
    assert "<script>" not in content
    assert "&lt;script&gt;" in content
    assert '<td class="bad">NO</td>' in content


def test_without_plotly_it_says_what_to_install(run, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "plotly.graph_objects", None)
    with pytest.raises(InputError, match=r"pip install 'ttc-workcell\[report\]'"):
        pages.plotly()
