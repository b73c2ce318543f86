"""The file of an arm, as MuJoCo can read it: MJCF as it is, URDF with its `package://` paths found.

A package of ROS is a folder; MuJoCo knows none. What `package://NAME/REST` means is looked for in the folders above the
file, as NAME/REST and as REST. The file itself is not touched: a copy with whole paths is compiled.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from workcell.errors import InputError
from workcell.scene import arm_file
from workcell.scene.arm_file import ArmFile

_PACKAGE = re.compile(r"package://([^/\"'<>]+)/([^\"'<>]+)")
_MESH = re.compile(r"""(<mesh\b[^>]*?filename\s*=\s*)(["'])([^"']+)\2""")
_READ_BY_MUJOCO = (".stl", ".obj", ".msh")


def read(path: Path) -> ArmFile:
    """Compile an arm file by itself; see `arm_file.read`.

    Raises:
        InputError: it cannot be read or compiled; names the file.
    """
    try:
        if path.suffix != ".urdf":
            return arm_file.read(path)
        text = path.read_text(encoding="utf-8")
        if "package://" not in text:
            return arm_file.read(path)
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / path.name
            copy.write_text(_with_whole_paths(text, path), encoding="utf-8")
            return replace(arm_file.read(copy), path=path)
    except InputError as error:
        raise InputError(error.faults, file=path) from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", file=path) from error


def _with_whole_paths(text: str, path: Path) -> str:
    """A URDF whose meshes are named by whole paths."""
    faults: list[str] = []

    def whole(match: re.Match[str]) -> str:
        head, quote, name = match.groups()
        package = _PACKAGE.fullmatch(name)
        if package is None:
            return f"{head}{quote}{(path.parent / name).resolve()}{quote}"
        places = list(_places(path, *package.groups()))
        found = next((place for place in places if place.is_file()), None)
        if found is None:
            faults.append(
                f"{name}: no such mesh in any folder above the file; allowed is NAME/... beside the file or above it"
            )
        elif found.suffix.lower() not in _READ_BY_MUJOCO:
            faults.append(
                f"{name}: MuJoCo reads {', '.join(_READ_BY_MUJOCO)}; convert it, or name another mesh"
            )
        return f"{head}{quote}{found}{quote}"

    changed = _MESH.sub(whole, text)
    if faults:
        raise InputError(faults)
    # MuJoCo takes meshes from the folder of the file unless it is told that their paths are whole.
    option = '<mujoco><compiler strippath="false" fusestatic="false"/></mujoco>'
    return (
        changed
        if "<mujoco>" in text
        else re.sub(r"(<robot\b[^>]*>)", rf"\1{option}", changed, count=1)
    )


def _places(path: Path, package: str, rest: str) -> Iterator[Path]:
    """Where a file of a package may be."""
    for folder in path.resolve().parents:
        yield folder / package / rest
        yield folder / rest
