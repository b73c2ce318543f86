"""The kinds of input that are mutated, and the commands that must take them or refuse them."""

from __future__ import annotations

import atexit
import copy
import shutil
import tempfile
import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w
from lxml import etree

from tests import cells
from tests.fuzz import mutate
from tests.fuzz.harness import Case, Target, call
from tests.fuzz.second_opinion import second_opinion
from workcell import assets

SHORT = ("--set", "simulation.duration_s=0.16")
"""A run of some ticks: enough for everything that is opened, made and judged before and after."""
LONG = ("--set", "simulation.duration_s=2.0")
"""Of a small cell: long enough for its arms to come together, which its judges must see alike."""


@cache
def _scenarios() -> tuple[dict[str, Any], ...]:
    """What mutations start from: the shipped scenarios, and small cells twice as often."""
    shipped = [
        tomllib.loads(assets.scenario_file(name).read_text(encoding="utf-8"))
        for name in assets.scenario_names()
    ]
    small = [cells.duet(), cells.duet(t_min_s=1.0, criterion="armd")]
    return (*shipped, *small * len(shipped))


def scenario(case: Case, folder: Path) -> None:
    """A scenario file: `check` takes or refuses it, and `run` does not refuse what `check` took."""
    random = Random(case.seed)
    content = random.choice(_scenarios())
    path = folder / "mutated.toml"
    overrides: list[str] = []
    if random.random() < 0.25:
        text = tomli_w.dumps(content).encode()
        path.write_bytes(mutate.damaged(random, text))
    elif random.random() < 0.2:
        path.write_text(tomli_w.dumps(content), encoding="utf-8")
        overrides = ["--set", f"{_dotted(random, content)}={random.choice(mutate.UGLY)}"]
    else:
        changed = mutate.tables(random, content, random.choice((1, 1, 2, 4)))
        try:
            path.write_text(tomli_w.dumps(changed), encoding="utf-8")
        except (TypeError, ValueError):  # what TOML cannot hold is no scenario file
            return
    small = all(arm["model"] == "planar3" for arm in content["arm"])
    _check_and_run(case, random, path, overrides, LONG if small else SHORT)


def _check_and_run(
    case: Case, random: Random, path: Path, overrides: list[str], length: Sequence[str] = SHORT
) -> None:
    checked = case.call("check", str(path), *overrides)
    if checked.status == 0 and random.random() < 0.3:
        short = (*overrides, *length)
        if case.call("check", str(path), *short).status == 0:
            ran = case.call("run", str(path), "--out", "run", *short)
            if ran.status == 2:
                case.faults.append(f"run refused what check had passed: {ran.err[:300]}")
            elif ran.status in (0, 1):
                case.judged += 1
                case.faults += second_opinion(Path("run"))


def _dotted(random: Random, content: Any) -> str:
    """A dotted key into the file, now and then with a typing error."""
    parts: list[str] = []
    node: Any = content
    while isinstance(node, (dict, list)) and node and random.random() < 0.9:
        if isinstance(node, dict):
            part = random.choice(list(node))
            node = node[part]
        else:
            index = random.randrange(len(node))
            part, node = str(index), node[index]
        parts.append(part)
    key = ".".join(parts)
    return mutate.typing_error(random, key) if random.random() < 0.2 else key


def arm(case: Case, folder: Path) -> None:
    """An arm file: taken or refused, by `check` and then by a short run."""
    random = Random(case.seed)
    name = random.choice(("planar3", "slider", "planar3", "pa10"))
    source = assets.model_file(name)
    for other in source.parent.glob("*"):
        if other.is_file() and other.suffix != ".py":
            shutil.copy(other, folder / other.name)
    text = source.read_bytes()
    changed = mutate.damaged(random, text) if random.random() < 0.3 else _mutated_xml(random, text)
    (folder / "arm.xml").write_bytes(changed)
    content = cells.duet()
    home = {
        "planar3": [1.9, -0.9, -0.6],
        "slider": [0.0],
        "pa10": [0.0, 0.6, 0.0, 1.6, 0.0, 0.9, 0.0],
    }
    content["arm"][1] |= {
        "model": "arm.xml",
        "home_rad": home[name],
        "base_position_m": [-1.2, 0.0, 0.0],
    }
    content["arm"][1]["job"] = [{"kind": "wait", "duration_s": 1.0}]
    path = folder / "cell.toml"
    path.write_text(tomli_w.dumps(content), encoding="utf-8")
    _check_and_run(case, random, path, [])


WORDS = (
    "0", "-1", "1e308", "nan", "inf", "", "true", "false", "auto", "degree", "radian", "x", "1 2 3", "0 0 0", "1 0 0 0",
    "0 0 0 0", "1e-300", "ball", "free", "hinge", "slide", "plane", "mesh", "sphere", "box", "hfield", "sdf", "/dev/zero",
    "none.stl", "../x.xml", "world", "floor", "tool", "base", "link1", "4", "-4", "99999999999999999999", "a" * 400,
)  # fmt: skip
INSERTED = (
    "<option timestep='0.1' integrator='RK4' gravity='0 0 0'/>", "<compiler angle='degree'/>", "<compiler autolimits='false'/>",
    "<visual><headlight active='0'/></visual>", "<default><geom group='4' type='box'/></default>", "<include file='arm.xml'/>",
    "<include file='/dev/zero'/>", "<asset><mesh name='m' file='/dev/zero'/></asset>", "<keyframe><key qpos='1 2'/></keyframe>",
    "<equality><joint joint1='J1' joint2='J2'/></equality>", "<tendon/>", "<contact><exclude body1='a' body2='b'/></contact>",
    "<worldbody><body mocap='true'><geom size='1'/></body></worldbody>", "<worldbody><body><freejoint/><geom size='1'/></body></worldbody>",
    "<size memory='1000G'/>", "<size njmax='-1'/>", "<extension/>", "<custom><numeric name='n' size='100000000'/></custom>",
    "<worldbody><geom type='plane' size='1 1 1'/></worldbody>", "<worldbody><replicate count='100000'><geom size='1'/></replicate></worldbody>",
    "<sensor><clock/></sensor>", "<unknown/>", "<!-- -- -->", "&lt;", "&bomb;",
)  # fmt: skip


def _mutated_xml(random: Random, text: bytes) -> bytes:
    """Attributes changed, dropped or misspelt, elements doubled, dropped or added."""
    root = etree.fromstring(text)
    for _ in range(random.choice((1, 1, 2, 4))):
        elements = [x for x in root.iter(etree.Element) if x is not root]
        element = random.choice(elements)
        match random.randrange(7):
            case 0 | 1 | 2 if element.attrib:
                key = random.choice(list(element.attrib))
                element.set(key, random.choice(WORDS))
            case 3 if element.attrib:
                del element.attrib[random.choice(list(element.attrib))]
            case 4:
                element.getparent().remove(element)
                if len(list(root.iter(etree.Element))) < 2:
                    break
            case 5:
                random.choice(elements).append(copy.deepcopy(element))
            case _:
                whole = etree.tostring(root).decode()
                return whole.replace("</mujoco>", random.choice(INSERTED) + "</mujoco>").encode()
    return etree.tostring(root)


def recording(case: Case, folder: Path) -> None:
    """A recording: taken or refused, and what `check` takes can be run."""
    random = Random(case.seed)
    time_s = [0.02 * k for k in range(random.choice((0, 1, 2, 20, 20, 20)))]
    x, y, z = -0.16590142, 0.4172214, 0.3  # where the tool of the small cell starts, about
    rows: list[list[Any]] = [[t, x + 0.01 * t, y, z, 1.0, 0.0, 0.0, 0.0] for t in time_s]
    header = ["time_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
    content = mutate.tables(random, {"header": header, "rows": rows}, random.choice((0, 1, 1, 3)))
    suffix = random.choice((".csv", ".csv", ".parquet"))
    path = folder / f"hand{suffix}"
    try:
        if suffix == ".csv":
            lines = [",".join(map(str, content["header"]))]
            lines += [",".join(map(str, row)) for row in content["rows"]]
            path.write_text("\n".join(lines), encoding="utf-8")
        else:
            columns = list(zip(*content["rows"], strict=True))
            pq.write_table(pa.table(dict(zip(content["header"], columns, strict=True))), path)
        if random.random() < 0.3:
            path.write_bytes(mutate.damaged(random, path.read_bytes()))
    except (KeyError, TypeError, ValueError, pa.ArrowException, OverflowError, AttributeError):
        return  # what cannot be written is no recording
    cell = cells.write(folder, cells.duet(d_min_m=0.005))
    key = f"arm.surgeon.operator.file={path}"
    loose = (
        "--set",
        "arm.surgeon.operator.jump_rad=7.0",
        "--set",
        "arm.surgeon.operator.jump_m=1.0",
    )
    _check_and_run(case, random, cell, ["--set", key, *(loose if random.random() < 0.8 else ())])


@cache
def _finished_run() -> Path:
    """A small run whose folder is damaged again and again."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz_run_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    call(["run", str(cells.write(folder, cells.duet())), "--out", str(folder / "run"), *SHORT])
    return folder / "run"


AFTER = (
    ("plot", "run"), ("salvage", "run"), ("record-operator", "run"), ("reproduce", "run", "--open-loop"),
)  # fmt: skip


def run_folder(case: Case, folder: Path) -> None:
    """A damaged run folder: every command that reads one tells or mends it."""
    random = Random(case.seed)
    shutil.copytree(_finished_run(), folder / "run")
    files = sorted(path for path in (folder / "run").rglob("*") if path.is_file())
    for _ in range(random.choice((1, 1, 2))):
        path = random.choice([x for x in files if "scene" not in x.parts] + files)
        if not path.is_file():
            continue
        content = path.read_bytes()
        path.unlink()
        match random.randrange(8):
            case 0:
                pass
            case 1:
                path.mkdir()
            case 2:
                path.write_bytes(b"")
            case 3:
                path.symlink_to(random.choice(("/dev/zero", "/dev/null", str(path), "nowhere")))
            case _:
                path.write_bytes(mutate.damaged(random, content))
    case.call(*random.choice(AFTER))
    case.call("compare", "run", str(_finished_run()))


TOKENS = (
    "list", "check", "run", "plot", "compare", "salvage", "record-operator", "replay", "sweep", "falsify", "judge", "bless",
    "reproduce", "handover", "nowhere", "none.toml", "/dev/zero", "/", ".", "", "\x00", "a" * 5000, "[red]", "--set", "--out",
    "--help", "--version", "--runs", "-1", "--seed", "1e308", "--workers", "0", "--", "-", "--unknown", "=", "a=b", "control.t_min_s",
    "control.t_min_s=", "control.t_min_s=nan", "arm.nurse.priority=9999999999999999999999", "x" * 300 + "=1", "..=1", "arm..=2",
    "--plot", "--target", "ttc", "--reason", "\udcff", "ünï",
)  # fmt: skip


def command_line(case: Case, folder: Path) -> None:
    """Words that commands may and may not take; none that would start a long work."""
    random = Random(case.seed)
    words = [random.choice(TOKENS) for _ in range(random.choice((0, 1, 2, 2, 3, 3, 4, 6)))]
    if words and words[0] in ("run", "sweep", "falsify", "bless", "replay") and "handover" in words:
        words = ["check", *words[1:]]
    case.call(*words)


TARGETS: dict[str, Target] = {
    "scenario": scenario,
    "arm": arm,
    "recording": recording,
    "run_folder": run_folder,
    "command_line": command_line,
}
"""Every kind of input by its name."""
