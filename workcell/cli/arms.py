"""Commands about arm files: import, and the look that `check` takes at one."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import tyro

from workcell import scenario as scenario_file
from workcell.cli.terminal import FAILED, OK, stdout
from workcell.errors import InputError


def import_(
    arm_file: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(metavar="ARM_FILE", help="an MJCF or URDF file")
    ],
    /,
    name: Annotated[
        str | None, tyro.conf.arg(metavar="NAME", help="of the adapted arm; default the file's")
    ] = None,
    tool: Annotated[
        str | None,
        tyro.conf.arg(metavar="SITE_OR_BODY", help="where the tool is; guessed if not given"),
    ] = None,
    tool_offset: Annotated[
        tuple[float, float, float],
        tyro.conf.arg(metavar="X Y Z", help="from there to the tool point, m, in its frame"),
    ] = (0.0, 0.0, 0.0),
    root: Annotated[
        str | None,
        tyro.conf.arg(metavar="BODY", help="where the arm begins; default the file's base"),
    ] = None,
    lock: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(metavar="JOINT=VALUE", help="hold a joint there; may be given several times"),
    ] = (),
    part: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(
            metavar="NAME=TOOL",
            help="one arm of several in the file, by its tool; give it once for each arm",
        ),
    ] = (),
    out: Annotated[
        Path, tyro.conf.arg(metavar="DIR", help="the arm's folder is made in it")
    ] = Path("arms"),
) -> int:
    """Adapt an arm file: capsules, housing, servos, limits, home, a picture and a first scenario; the original is not touched."""
    from workcell.scene.adapt import Wishes, adapt

    if not arm_file.is_file():
        raise InputError(
            f"no such arm file: {str(arm_file)!r}; allowed: a path to an MJCF or URDF file"
        )
    wishes = Wishes(name, tool, tool_offset, root, _locks(lock))
    if part:
        if tool is not None or root is not None:
            raise InputError("--part: says what --tool and --root say; allowed is one or the other")
        return _import_parts(arm_file, _parts(part), wishes, out)
    from workcell.scene.adapt.starter import scenario_text

    adapted = adapt(arm_file, wishes)
    folder = out / adapted.name
    _write(adapted, arm_file, folder, out)
    scene = folder / f"{adapted.name}_pair.toml"
    said = _starter(scene, lambda step_m: scenario_text(adapted, step_m))
    for line in (scene, said):
        stdout.print(str(line), markup=False)
    return OK


def _import_parts(arm_file: Path, tools: dict[str, str], wishes, out: Path) -> int:
    """Adapt several arms of one file, and write a scenario in which all of them stand."""
    from workcell.scene.adapt.parts import adapt_parts
    from workcell.scene.adapt.starter import robot_text

    robot = adapt_parts(arm_file, tools, wishes)
    folder = out / robot.name
    for name, adapted in robot.parts.items():
        stdout.print(f"part {name}:", markup=False)
        _write(adapted, arm_file, folder, out)
    for line in robot.said:
        stdout.print(f"done: {line}", markup=False)
    for near in robot.ignored:
        still = "; the final check still does" if near.housings_apart else ""
        stdout.print(
            f"done: {near.one} and {near.other} are not held apart ([[ignore]]): {near.reason}{still}",
            markup=False,
        )
    scene = folder / f"{robot.name}_cell.toml"
    said = _starter(scene, lambda step_m: robot_text(robot, step_m))
    for line in (scene, said):
        stdout.print(str(line), markup=False)
    return OK


def _write(adapted, original: Path, folder: Path, out: Path) -> None:
    """Write an adapted arm and its picture, and say what was done."""
    target = folder / f"{adapted.name}.xml"
    if target.resolve() == original.resolve():
        raise InputError(
            f"--out {out}: would replace the original {original}; choose another folder or --name"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        target.write_text(adapted.xml, encoding="utf-8")
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written: {error.strerror}") from error
    pictured = _picture(adapted, folder / f"{adapted.name}.png")
    for title, lines in (
        ("done", adapted.did),
        ("guessed", adapted.guessed),
        ("not known", adapted.unknown),
    ):
        for line in lines:
            stdout.print(f"{title}: {line}", markup=False)
    stdout.print(f"home_rad = [{', '.join(f'{q:g}' for q in adapted.home_rad)}]", markup=False)
    for line in (target, pictured):
        stdout.print(str(line), markup=False)


def _picture(adapted, path: Path) -> str:
    """Draw the arm from three sides, where the library for it is installed."""
    try:
        from workcell.view import arm_sides
    except ModuleNotFoundError:
        return "no picture: pip install 'ttc-workcell[figures]'"
    arm_sides.draw(adapted.xml, adapted.home_rad, path)
    return str(path)


def check_arm(path: Path) -> int:
    """Say what an arm file lacks, in the order in which to mend it, and what is assumed of it."""
    from workcell.scene.adapt.look import look

    if not path.is_file():
        raise InputError(f"no such arm file: {str(path)!r}")
    missing, told = look(path)
    for number, fault in enumerate(missing, start=1):
        stdout.print(f"{number}. {fault}", markup=False)
    for line in told:
        stdout.print(line, markup=False)
    if not missing:
        stdout.print(f"{path}: an arm of a cell as it is", markup=False)
        return OK
    stdout.print(f"{path}: {len(missing)} things to mend; `workcell import {path}`", markup=False)
    return FAILED


def _starter(path: Path, text: Callable[[float | None], str]) -> str:
    """Write the first scenario that can be run, and say which it is."""
    from workcell import run
    from workcell.scene.adapt.starter import STEPS_M

    refused = None
    for step_m in STEPS_M:
        path.write_text(text(step_m), encoding="utf-8")
        try:
            with tempfile.TemporaryDirectory() as scene:
                run.prepare(scenario_file.load(path), Path(scene))
        except InputError as error:
            refused = refused or error
            continue
        return f"first scenario: workcell run {path}"
    return (
        f"first scenario is not ready to run: {refused}\n`workcell place {path}` searches a layout"
    )


def _parts(texts: tuple[str, ...]) -> dict[str, str]:
    """NAME=TOOL of the command line."""
    found = {}
    for text in texts:
        name, _, tool = text.partition("=")
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or not tool or name in found:
            raise InputError(
                f"--part {text}: allowed is NAME=TOOL, each name once, of letters, digits and _"
            )
        found[name] = tool
    if len(found) < 2:
        raise InputError(
            f"--part {texts[0]}: allowed are two parts or more; for one arm use --tool"
        )
    return found


def _locks(texts: tuple[str, ...]) -> dict[str, float]:
    """JOINT=VALUE of the command line."""
    found = {}
    for text in texts:
        joint, _, value = text.rpartition("=")
        try:
            found[joint] = float(value)
        except ValueError as error:
            raise InputError(
                f"--lock {text}: allowed is JOINT=VALUE, a number in rad or m"
            ) from error
        if not joint:
            raise InputError(f"--lock {text}: allowed is JOINT=VALUE, a number in rad or m")
    return found
