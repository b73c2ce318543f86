"""A device from a plug-in feeds a live operator through the same filter as every stream."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from tests import cells
from workcell import plugins, provenance, scenario
from workcell.errors import ControlFault
from workcell.motion.operators import make_operator

HOME = np.array([0.4, 0.5, 0.4])
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])

GLOVE = """
import numpy as np
from pydantic import BaseModel, ConfigDict
from workcell.motion.operators.samples import Sample


class Glove:
    class Options(BaseModel):
        model_config = ConfigDict(extra="forbid")
        fault: str = ""

    def __init__(self, setup):
        if setup.options.fault == "missing":
            raise OSError("no glove is plugged in")
        self.setup, self.count = setup, 0

    def samples(self, now_s):
        self.count += 1
        if self.setup.options.fault == "lost" and now_s > 0.5:
            raise OSError("the cable is out")
        if self.setup.options.fault == "shape":
            return [Sample(now_s, np.zeros(2), self.setup.wxyz)]
        if self.count % 2:
            return []
        away = np.array([0.05 * np.sin(now_s), 0.0, 0.0])
        if self.setup.options.fault == "spike" and 0.5 < now_s < 0.53:
            away = np.array([0.0, 0.0, 2.0])
        return [Sample(now_s, self.setup.position_m + away, self.setup.wxyz)]


DEVICES = {"glove": Glove}
"""


@pytest.fixture(autouse=True)
def glove(tmp_path, monkeypatch):
    monkeypatch.setenv(plugins.FILES_VARIABLE, "")
    (tmp_path / "glove.py").write_text(GLOVE)
    plugins.use_files([tmp_path / "glove.py"])


def play(fault="", seconds=1.0):
    settings = scenario.Live.model_validate(
        {"kind": "live", "device": "glove", "device_options": {"fault": fault}}
    )
    operator = make_operator(settings, HOME, UPRIGHT, name="surgeon", period_s=0.01)
    return [operator.setpoint(t) for t in np.arange(0.0, seconds, 0.01).tolist()]


def test_its_samples_are_followed():
    setpoints = play()
    assert {w.state for w in setpoints} == {"waiting", "valid"}
    way = setpoints[-1].target.position_m - HOME
    assert way == pytest.approx([0.05 * np.sin(0.99), 0.0, 0.0], abs=0.01)


def test_its_faults_are_those_of_a_stream():
    setpoints = play("spike")
    assert "jump" in {w.state for w in setpoints}
    assert max(w.target.position_m[2] for w in setpoints) == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("lost", "device 'glove' raised OSError: the cable is out"),
        ("shape", r"device 'glove' raised TypeError: shapes \(3,\) and \(4,\) are needed"),
    ],
)
def test_one_that_fails_ends_the_run_with_its_name(fault, said):
    with pytest.raises(ControlFault, match=said):
        play(fault)


def test_its_version_goes_with_a_run(tmp_path):
    content = cells.duet()
    content["arm"][0]["operator"] = {"kind": "live", "device": "glove"}
    digest = hashlib.sha256((tmp_path / "glove.py").read_bytes()).hexdigest()
    told = provenance.versions(cells.load(tmp_path, content))
    assert told["device glove"] == f"glove.py {digest[:12]}"
    content["arm"][0]["operator"] = {"kind": "live"}
    assert "device glove" not in provenance.versions(cells.load(tmp_path, content))


def test_one_that_cannot_be_made_or_is_unknown_is_refused():
    with pytest.raises(Exception, match="device 'glove' cannot be made: OSError: no glove"):
        play("missing")
    for settings, said in (
        ({"device": "glov"}, "unknown device 'glov'; known here: glove; did you mean 'glove'"),
        (
            {"device": "glove", "device_options": {"size": 1}},
            r"device\.glove\.size: unknown key 'size'",
        ),
        ({"device_options": {"size": 1}}, "device_options needs a device"),
    ):
        with pytest.raises(ValueError, match=said):
            scenario.Live.model_validate({"kind": "live", **settings})


def test_a_scenario_cannot_name_a_file_to_be_run(tmp_path, monkeypatch):
    """Opening a stranger's scenario runs no stranger's code: a path is not a name."""
    (tmp_path / "trap.py").write_text("open('ran', 'w')\nDEVICES = {'trap': object}\n")
    monkeypatch.chdir(tmp_path)
    for name in ("trap.py", str(tmp_path / "trap.py"), "trap", "os:system"):
        with pytest.raises(ValueError, match="device"):
            scenario.Live.model_validate({"kind": "live", "device": name})
    assert not (tmp_path / "ran").exists()
