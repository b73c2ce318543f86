"""What is refused, in which words; what is read is what is meant."""

from __future__ import annotations

import pytest

from tests import cells
from workcell import assets, scenario
from workcell.control import feasible
from workcell.errors import InputError
from workcell.run import prepare


def refusal(folder, content, *overrides: str) -> str:
    """The message a scenario is refused with when its file is read."""
    path = content if not isinstance(content, dict) else cells.write(folder, content)
    with pytest.raises(InputError) as refused:
        scenario.load(path, overrides)
    assert str(path) in str(refused.value), "every message names the file"
    return str(refused.value)


def refusal_of_cell(folder, content, *overrides: str) -> str:
    """The message a scenario that reads well is refused with when its cell is made and judged."""
    loaded = cells.load(folder, content, *overrides)
    with pytest.raises(InputError) as refused:
        prepare(loaded, folder / "scene")
    assert loaded.file in str(refused.value), "every message names the file"
    return str(refused.value)


def test_broken_toml_is_refused_with_its_line(tmp_path):
    path = tmp_path / "broken.toml"
    path.write_text("[simulation]\nplant = kinematic\n")
    assert "not valid TOML" in refusal(tmp_path, path)
    assert "line 2" in refusal(tmp_path, path)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "bytes.toml"
    path.write_bytes(b"\xff\xfe\x00")
    assert "not valid TOML" in refusal(tmp_path, path)


def test_an_unknown_scenario_is_answered_with_those_that_exist():
    with pytest.raises(InputError, match=r"no such scenario: 'handoff'.*handover"):
        scenario.load("handoff")


@pytest.mark.parametrize(
    ("override", "names"),
    [
        ("control.t_min=1", ("control.t_min", "unknown key", "t_min_s", "d_min_m")),
        ("arm.nurse.colour='red'", ("arm.nurse.colour", "'red'", "unknown key", "home_rad")),
        ("arm.nurse.job.0.dwell=1", ("job", "dwell", "unknown key", "dwell_s")),
        ("control.t_min_s=nan", ("control.t_min_s", "nan", "finite")),
        ("control.d_min_m=inf", ("control.d_min_m", "inf", "finite")),
        ("control.t_min_s=0", ("control.t_min_s = 0", "greater than 0")),
        ("arm.nurse.home_rad.0=nan", ("arm.nurse.home_rad", "finite")),
        ("arm.nurse.base_wxyz=[1,1,0,0]", ("arm.nurse.base_wxyz", "unit quaternion", "1.41421")),
        ("control.criterion=best", ("control.criterion", "'best'", "artc, ", "none")),
        ("control.order=3", ("control.order", "3", "1 or 2")),
        ("simulation.plant=real", ("simulation.plant", "'real'", "'dynamic'", "'kinematic'")),
        ("simulation.period_s=0.5", ("simulation.period_s", "0.5", "0.02")),
        ("arm.nurse.job=[]", ("arm.nurse", "operator", "jobs", "exactly one")),
        ("arm.nurse.job.0.arm=doctor", ("nurse", "'doctor'", "not another arm", "surgeon")),
        ("arm.nurse.velocity_limit_rad_s=[1.0]", ("velocity_limit_rad_s", "1 entries", "3")),
        ("arm.nurse.name=surgeon", ("arm names must be unique", "surgeon")),
        ("arm.nurse.name='the nurse'", ("arm.the nurse.name", "'the nurse'", "pattern")),
        ("expect.completed={}", ("expect.completed", "min, max or equals")),
    ],
)
def test_what_does_not_fit_is_refused_by_key_value_and_what_is_allowed(tmp_path, override, names):
    content = cells.duet()
    if override.startswith("arm.nurse.home_rad.0"):
        content["arm"][1]["home_rad"][0], override = float("nan"), ()
    message = refusal(tmp_path, content, *([override] if override else []))
    for name in names:
        assert name in message


@pytest.mark.parametrize(
    ("override", "names"),
    [
        (
            "expect.completed={mim = 1}",
            ("expect.completed.mim", "unknown key", "equals, max, min", "'min'?"),
        ),
        ("vary.x={mean = 1, st = 2}", ("vary.x.st", "unknown key", "choices, log, max, mean")),
        ("simulation.perod_s=0.01", ("simulation.perod_s", "did you mean 'period_s'?")),
        ("arm.nurse.job.0.kind=meat", ("arm.nurse.job.0", "'meat'", "'meet'")),
    ],
)
def test_typing_errors_are_answered_with_what_is_allowed(tmp_path, override, names):
    message = refusal(tmp_path, cells.duet(), override)
    for name in names:
        assert name in message


EXTREME = (
    "1e308",
    "-1e308",
    "5e-324",
    "nan",
    "inf",
    "-inf",
    "1" + "0" * 400,
    "1" * 5000,
    "-1",
    "1e12",
)


@pytest.mark.parametrize(
    "key",
    [
        "simulation.period_s",
        "simulation.latency_ticks",
        "control.t_min_s",
        "control.criterion_gain",
        "arm.nurse.priority",
        "arm.nurse.job_repeat",
        "arm.nurse.job.0.speed_m_s",
        "arm.nurse.job.0.dwell_s",
        "check.every_ticks",
    ],
)
@pytest.mark.parametrize("value", EXTREME)
def test_extreme_numbers_are_refused_by_key(tmp_path, key, value):
    assert key.rpartition(".")[2] in refusal(tmp_path, cells.duet(), f"{key}={value}")


@pytest.mark.parametrize(
    ("override", "names"),
    [
        ("arm.nurse.job_repeat=9000", ("arm.nurse.job_repeat = 9000", "18,000 jobs", "10,000")),
        ("simulation.duration_s=604800", ("simulation.duration_s", "7.56e+07 ticks", "50,000,000")),
        ("simulation.duration_s=0.001", ("simulation.duration_s", "0.125 ticks", "1 to")),
    ],
)
def test_work_without_end_is_refused(tmp_path, override, names):
    message = refusal(tmp_path, cells.duet(), override)
    for name in names:
        assert name in message


@pytest.mark.parametrize(
    ("table", "name", "told"),
    [
        ("arm", "floor", "a part of every scene"),
        ("arm", "world", "a part of every scene"),
        ("obstacle", "scalpel_capsule", "a part of instrument scalpel"),
        ("obstacle", "scalpel", "an obstacle and of an instrument"),
        ("instrument", "surgeon", "an arm and of an instrument"),
    ],
)
def test_names_that_clash_with_the_scene_are_refused(tmp_path, table, name, told):
    content = cells.duet()
    content["instrument"] = [{"name": "scalpel", "position_m": [0.0, 2.0, 0.0]}]
    content["obstacle"] = [
        {"name": "block", "shape": "sphere", "size_m": [0.1], "position_m": [0.0, 2.0, 0.0]}
    ]
    content[table][-1]["name"] = name
    assert told in refusal(tmp_path, content)


@pytest.mark.parametrize("value", ["a\u0000b", "a\u001b[31m", "/" + "c/" * 2500])
@pytest.mark.parametrize("key", ["arm.nurse.model", "arm.surgeon.operator.file"])
def test_paths_that_are_none_are_refused(tmp_path, key, value):
    message = refusal(tmp_path, cells.duet(), f'{key}="{value}"')
    assert key in message
    assert len(message) < 2000


def test_what_is_no_scenario_file_is_refused_in_time(tmp_path):
    (tmp_path / "deep.toml").write_text("x = " + "[" * 20000)
    (tmp_path / "digits.toml").write_text("x = " + "9" * 5000)
    (tmp_path / "large.toml").write_text("#" * 5_000_000)
    (tmp_path / "link.toml").symlink_to("/dev/zero")
    assert "nested too deeply" in refusal(tmp_path, tmp_path / "deep.toml")
    assert "not valid TOML" in refusal(tmp_path, tmp_path / "digits.toml")
    assert "larger than" in refusal(tmp_path, tmp_path / "large.toml")
    for path, told in (
        (tmp_path / "link.toml", "not a file"),
        (tmp_path, "not a file"),
        ("a\0b", "no such"),
    ):
        with pytest.raises(InputError, match=told):
            scenario.load(path)
    with pytest.raises(InputError, match="File name too long"):
        scenario.load("x" * 5000)


def test_a_newer_format_is_refused_and_this_one_is_written(tmp_path):
    assert "format = 2: this program reads formats up to 1" in refusal(
        tmp_path, cells.duet(), "format=2"
    )
    loaded = cells.load(tmp_path, cells.duet(), "format=1")
    assert loaded.to_toml().startswith("format = 1\n")
    assert loaded.digest() == cells.load(tmp_path, cells.duet()).digest()


def test_several_faults_are_reported_at_once(tmp_path):
    content = cells.duet(t_min_s=-1.0, d_min=0.01)
    content["arm"][0]["base_position_m"] = [0.0, float("nan"), 0.0]
    content["arm"][1]["model"] = 3
    del content["arm"][1]["home_rad"]
    faults = refusal(tmp_path, content).splitlines()
    assert len(faults) == 5
    for name in ("control.t_min_s", "control.d_min", "base_position_m", "nurse.model", "home_rad"):
        assert any(name in fault for fault in faults)


@pytest.mark.parametrize(
    ("obstacle", "names"),
    [
        ({"shape": "box", "size_m": [1.0, 1.0]}, ("2 entries", "a box has 3")),
        ({"shape": "cone", "size_m": [1.0]}, ("'cone'", "'sphere'", "'cylinder'")),
        ({"shape": "sphere", "size_m": [0.0]}, ("size_m.0", "greater than 0")),
        ({"name": "nurse", "shape": "sphere", "size_m": [0.1]}, ("nurse", "name of an arm")),
    ],
)
def test_obstacles_are_checked_too(tmp_path, obstacle, names):
    content = cells.duet()
    content["obstacle"] = [{"name": "block", "position_m": [0, 2, 0]} | obstacle]
    message = refusal(tmp_path, content)
    for name in names:
        assert name in message


@pytest.mark.parametrize(
    ("override", "names"),
    [
        ("gibberish", ("--set 'gibberish'", "KEY=VALUE")),
        ("=3", ("--set '=3'", "KEY=VALUE")),
        ("arm.doctor.priority=1", ("--set arm.doctor.priority", "'doctor'", "surgeon, nurse")),
        ("arm.nurse=1", ("--set arm.nurse", "one of several")),
        ("control.t_min_s.x=1", ("--set control.t_min_s.x", "a value, not a table")),
    ],
)
def test_overrides_that_reach_nothing_are_refused(tmp_path, override, names):
    message = refusal(tmp_path, cells.duet(t_min_s=1.0), override)
    for name in names:
        assert name in message


def test_overrides_reach_every_kind_of_key(tmp_path):
    loaded = cells.load(
        tmp_path,
        cells.duet(),
        "control.t_min_s=0.8",  # a table the file need not have
        "control.criterion=armd",  # a bare word is text
        "arm.nurse.priority=4",  # an arm by its name
        "arm.0.base_position_m=[1, 2, 3]",  # or by its place
        "arm.nurse.job.0.dwell_s=1.5",
        'arm.surgeon.operator={kind="waypoints", waypoints=[{position_m=[0.1, 0.2, 0.3]}]}',
        "expect.completed=true",
    )
    surgeon, nurse = loaded.arm
    assert (loaded.control.t_min_s, loaded.control.criterion) == (0.8, "armd")
    assert nurse.priority == 4
    assert surgeon.base_position_m == (1.0, 2.0, 3.0)
    assert nurse.job[0].dwell_s == 1.5
    assert surgeon.operator.waypoints[0].position_m == (0.1, 0.2, 0.3)
    assert loaded.expect["completed"].equals is True


@pytest.mark.parametrize("name", assets.scenario_names())
def test_a_resolved_scenario_reads_back_as_itself(tmp_path, name):
    original = scenario.load(name)
    (tmp_path / "resolved.toml").write_text(original.to_toml(), encoding="utf-8")
    again = scenario.load(tmp_path / "resolved.toml")
    assert again.model_dump() == original.model_dump()
    assert again.digest() == original.digest()
    assert scenario.load(name, ("simulation.seed=12345",)).digest() != original.digest()


def test_models_are_found_from_the_scenarios_own_folder(tmp_path, monkeypatch):
    (tmp_path / "own.xml").write_text(assets.model_file("slider").read_text())
    content = cells.duet()
    content["arm"][1] |= {"model": "own.xml", "home_rad": [0.0]}
    content["arm"][1]["base_position_m"] = [0.0, -2.0, 0.0]
    monkeypatch.chdir("/")
    assert cells.load(tmp_path, content).arm[1].model == str(tmp_path / "own.xml")
    assert cells.build(tmp_path, content).model.nv == 4


# ---------------------------------------------------------------- what only the cell can tell


def arm_file(folder, body: str, extra: str = "") -> str:
    (folder / "arm.xml").write_text(
        f"<mujoco><compiler angle='radian'/><worldbody>{body}</worldbody>{extra}</mujoco>"
    )
    return str(folder / "arm.xml")


LINK = "<body name='link'>{}<geom name='g' type='capsule' size='0.05 0.1'/>{}</body>"
HINGE, SITE = "<joint name='J'/>", "<site name='tool'/>"
SERVO = "<actuator><position joint='J' kp='10' kv='1'/></actuator>"


@pytest.mark.parametrize(
    ("body", "extra", "names"),
    [
        (None, "", ("no such arm file", "pa10", "planar3", "slider")),
        ("<body", "", ("not a readable MJCF file",)),
        (LINK.format("", SITE), "", ("has no joints", "hinge or slide")),
        (LINK.format(HINGE, ""), SERVO, ("tool_site = 'tool'", "no such site", "no sites")),
        (
            LINK.format(HINGE, "<site name='tip'/>"),
            SERVO,
            ("tool_site = 'tool'", "allowed: tip"),
        ),
        (
            LINK.format("<joint name='J' type='ball'/>", SITE),
            "",
            ("'J'", "ball", "hinge and slide"),
        ),
        (
            LINK.format(HINGE, SITE),
            "<actuator><motor joint='J'/></actuator>",
            ("neither a position nor a velocity servo",),
        ),
    ],
)
def test_arm_files_that_cannot_be_driven_are_refused(tmp_path, body, extra, names):
    content = cells.duet()
    model = "missing.xml" if body is None else arm_file(tmp_path, body, extra)
    content["arm"][1] |= {"model": model, "home_rad": [0.0]}
    message = refusal_of_cell(tmp_path, content)
    assert "arm.nurse." in message
    for name in names:
        assert name in message


def test_faults_of_all_arms_are_reported_at_once(tmp_path):
    content = cells.duet()
    content["arm"][0]["model"] = "missing.xml"
    content["arm"][1] |= {"home_rad": [0.0, 0.0], "tool_site": "tip"}
    message = refusal_of_cell(tmp_path, content)
    assert "arm.surgeon.model" in message
    assert "arm.nurse.home_rad: has 2 entries, planar3.xml has 3 joints" in message
    assert "arm.nurse.tool_site = 'tip'" in message


def test_home_beyond_the_range_of_a_joint_is_refused(tmp_path):
    message = refusal_of_cell(tmp_path, cells.duet(), "arm.nurse.home_rad=[1.9, -0.9, 2.7]")
    assert "arm.nurse.home_rad.2 = 2.7" in message
    assert "-2.6 to 2.6" in message


def test_start_in_collision_is_refused_with_every_pair(tmp_path):
    message = refusal_of_cell(tmp_path, cells.duet(), "arm.nurse.base_position_m=[0.5, 0.0, 0.0]")
    assert "start in collision" in message
    assert "surgeon/base_capsule and nurse/base_capsule" not in message, "neither can move"
    assert "surgeon/link1_capsule and nurse/link1_capsule are -" in message
    assert "d_min_m = 0.01" in message


@pytest.mark.parametrize("driver", ["job", "operator"])
def test_a_pose_out_of_reach_is_refused_with_place_and_error(tmp_path, driver):
    content = cells.duet()
    far = [{"position_m": [-0.55, 1.5, 0.3]}]
    if driver == "job":
        content["arm"][1]["job"] = [{"kind": "move", "waypoints": far}]
        key = "arm.nurse.job.0.waypoints"
    else:
        content["arm"][0]["operator"] = {"kind": "waypoints", "waypoints": far}
        key = "arm.surgeon.operator.waypoints"
    message = refusal_of_cell(tmp_path, content)
    assert f"{key}: out of reach at (" in message
    assert "m away" not in message
    assert "rad away" in message


def test_t_min_too_small_to_brake_in_is_refused_with_the_smallest_allowed(tmp_path):
    message = refusal_of_cell(tmp_path, cells.duet(t_min_s=0.01))
    assert "control.t_min_s = 0.01: too small for arm nurse to brake in from 0.15 m/s" in message
    allowed = float(message.split("allowed is ")[1].split()[0])
    built = cells.build(tmp_path, cells.duet(t_min_s=allowed + 0.001))
    feasible.check(built)
