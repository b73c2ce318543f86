"""Plug-ins: found by name from packages and files given by hand, never from a scenario."""

from __future__ import annotations

import os

import pytest
from pydantic import BaseModel, Field

from workcell import plugins
from workcell.errors import InputError


@pytest.fixture(autouse=True)
def own_environment(monkeypatch):
    monkeypatch.setenv(plugins.FILES_VARIABLE, "")


def write(folder, text):
    file = folder / "mine.py"
    file.write_text(text, encoding="utf-8")
    return file


def test_everything_built_in_can_be_loaded():
    for kind, names in plugins.BUILT_IN.items():
        for name in names:
            assert isinstance(plugins.load(kind, name), int if kind == "criteria" else type)


def test_a_file_given_by_hand_brings_its_names_and_child_processes_know_it(tmp_path):
    file = write(tmp_path, "class Mine: pass\nSTRATEGIES = {'mine': Mine}\n")
    plugins.use_files([file])
    assert plugins.load("strategies", "mine").__name__ == "Mine"
    assert plugins.known("strategies")["mine"].source == str(file)
    assert os.environ[plugins.FILES_VARIABLE] == str(file)
    told = plugins.versions([("strategies", "mine")])
    assert list(told) == ["strategy mine"]
    assert told["strategy mine"].startswith("mine.py ")


def test_an_unknown_name_is_refused_with_the_names_there_are():
    with pytest.raises(
        InputError, match=r"unknown strategy 'tcc'; known here: .*ttc.*; did you mean 'ttc'\?"
    ):
        plugins.load("strategies", "tcc")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("raise RuntimeError('no')", "RuntimeError: no"),
        ("import no_such_module_anywhere", "ModuleNotFoundError"),
        ("def f(:", "SyntaxError"),
        ("x = 1", "sets none of STRATEGIES, CRITERIA, OPERATORS, DEVICES"),
    ],
)
def test_a_file_that_is_none_is_refused_by_its_name(tmp_path, text, said):
    file = write(tmp_path, text)
    with pytest.raises(InputError, match=said) as caught:
        plugins.use_files([file])
    assert "mine.py" in str(caught.value)


def test_a_missing_file_and_a_name_brought_twice_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"--plugin nowhere\.py: no such file"):
        plugins.use_files(["nowhere.py"])
    plugins.use_files([write(tmp_path, "STRATEGIES = {'ttc': object}")])
    with pytest.raises(
        InputError, match=r"strategy 'ttc' is brought twice: by built in and by .*mine\.py"
    ):
        plugins.known("strategies")


def test_options_are_validated_by_the_model_that_the_plug_in_brings(monkeypatch):
    class Mine:
        class Options(BaseModel, extra="forbid"):
            gain: float = Field(1.0, gt=0.0)

    monkeypatch.setattr(plugins, "load", lambda kind, name: Mine)
    assert plugins.options("strategies", "mine", {"gain": 2.0}).gain == 2.0
    for given, said in (
        ({"gain": -1.0}, r"strategy\.mine\.gain: .*greater than 0"),
        ({"gian": 1.0}, r"strategy\.mine\.gian"),
    ):
        with pytest.raises(InputError, match=said):
            plugins.options("strategies", "mine", given)
    monkeypatch.setattr(plugins, "load", lambda kind, name: object)
    assert plugins.options("strategies", "mine", {}) is None
    with pytest.raises(InputError, match="takes no options; given gain"):
        plugins.options("strategies", "mine", {"gain": 1.0})
