"""Arms of libraries are adapted once into the user's cache; the libraries are stand-ins of the same interface."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import pytest

from tests.scene.test_compose import mixed
from tests.scene.test_normal_form import leg
from workcell import scenario
from workcell.cli import main
from workcell.errors import InputError
from workcell.scene import cell as scene
from workcell.scene.adapt import library


@pytest.fixture
def menagerie(tmp_path, monkeypatch):
    """A stand-in for mujoco-menagerie: names, robots, get, xml."""
    path = leg(tmp_path / "models")
    robot = SimpleNamespace(name="leg", default_model="leg", xml=lambda entry: path)
    module = ModuleType("mujoco_menagerie")
    module.MenagerieError = type("MenagerieError", (Exception,), {})
    module.names = lambda: ["leg", "walker"]
    module.robots = lambda category=None: [robot]
    module.get = {"leg": robot}.__getitem__
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", module)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return SimpleNamespace(module=module, path=path, robot=robot)


def one(model: str) -> dict:
    content = mixed("planar3")
    content["arm"][0] |= {"model": model, "home_rad": "key:home"}
    return content


def test_an_arm_of_the_menagerie_is_adapted_once(tmp_path, menagerie, monkeypatch):
    asked = scenario.validate(one("menagerie:leg"), None)
    first = scene.build(asked, tmp_path / "one")
    assert first.arms[0].joints == ("arm0/hip", "arm0/knee")
    kept = library.adapted_file("menagerie:leg")
    assert kept.is_relative_to(tmp_path / "cache")
    monkeypatch.setattr(library, "adapt", None)
    assert scene.build(asked, tmp_path / "two").digest == first.digest


def test_a_change_of_the_source_is_adapted_anew(menagerie):
    before = library.adapted_file("menagerie:leg")
    menagerie.path.write_text(menagerie.path.read_text().replace('size="0.04"', 'size="0.041"'))
    after = library.adapted_file("menagerie:leg")
    assert before != after
    assert before.read_text() != after.read_text()


def test_its_name_stays_a_name_in_a_scenario_file(tmp_path, menagerie):
    path = tmp_path / "one.toml"
    path.write_text(
        '[[arm]]\nname = "a"\nmodel = "menagerie:leg"\nhome_rad = "key:home"\noperator = { kind = "hold" }\n'
    )
    assert scenario.load(path).arm[0].model == "menagerie:leg"


def test_robot_descriptions_go_the_same_way(tmp_path, menagerie, monkeypatch):
    package, module = ModuleType("robot_descriptions"), ModuleType("robot_descriptions.leg_mj")
    module.MJCF_PATH = str(menagerie.path)
    monkeypatch.setitem(sys.modules, "robot_descriptions", package)
    monkeypatch.setitem(sys.modules, "robot_descriptions.leg_mj", module)
    assert library.adapted_file("robot_descriptions:leg_mj").is_file()


def test_a_scenario_cannot_have_other_modules_of_a_library_imported(tmp_path, monkeypatch):
    """Opening a stranger's scenario runs no stranger's code, and of a library only what describes arms."""
    asked = []
    monkeypatch.setattr(library.importlib, "import_module", asked.append)
    for name in ("__main__", "_cache", "loaders.mujoco", "..evil", "", "evil/evil"):
        with pytest.raises(InputError, match="is no name of a description"):
            scene.build(scenario.validate(one(f"robot_descriptions:{name}"), None), tmp_path)
    assert asked == []


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ("menagerie:lug", "no such robot; its arms are leg"),
        ("robot_descriptions:lug", "the package robot_descriptions is not installed; pip install"),
    ],
)
def test_what_a_library_does_not_have_is_refused(tmp_path, menagerie, monkeypatch, model, words):
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    with pytest.raises(InputError) as refused:
        scene.build(scenario.validate(one(model), None), tmp_path)
    assert "arm.arm0.model = " in str(refused.value)
    assert words in str(refused.value)


def test_check_says_of_an_arm_file_what_to_mend(tmp_path, capsys):
    path = leg(tmp_path, limits="", more='<geom name="horn" class="thin" size="0.2" mass="0.1"/>')
    assert main(["check", str(path)]) == 1
    said = capsys.readouterr().out
    assert "1. shin: housing horn reaches 150.0 mm out of its capsules" in said
    assert "2. gravity is not compensated for thigh" in said
    assert "joint_velocity_limit_rad_s: not stated" in said
    assert "2 joints move tool: hip, knee" in said


def test_check_finds_nothing_to_mend_on_a_shipped_arm(capsys):
    from workcell import assets

    assert main(["check", str(assets.model_file("planar3"))]) == 0
    said = capsys.readouterr().out
    assert "an arm of a cell as it is" in said
    assert "joint_velocity_limit_rad_s, in force: " in said
    assert "two such arms have 15 watched pairs between them" in said
