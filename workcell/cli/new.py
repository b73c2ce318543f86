"""The command that writes a working start for something of one's own: new."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

import tyro

from workcell.cli.terminal import OK, stdout
from workcell.errors import InputError


def new(
    what: Annotated[
        Literal["strategy", "criterion", "scenario", "arm"],
        tyro.conf.Positional,
        tyro.conf.arg(help="what to write a start for"),
    ],
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME", help="its name")],
    /,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help="folder; made if missing")] = Path(),
) -> int:
    """Write a working example of a strategy or a criterion (with its test), a scenario, or an arm with a scenario."""
    for file in write(what, name, out):
        stdout.print(str(file), markup=False)
    return OK


def write(what: str, name: str, out: Path) -> list[Path]:
    """Write the example's files.

    Returns:
        What was written.

    Raises:
        InputError: The name is no identifier, or a file is there already.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise InputError(
            f"new {what} {name}: a name starts with a small letter and holds small letters, digits and _"
        )
    templates = sorted(
        files("workcell").joinpath("templates", what).iterdir(), key=lambda f: f.name
    )
    wanted = {
        out / file.name.replace("NAME", name): file for file in templates if "NAME" in file.name
    }
    there = [str(path) for path in wanted if path.exists()]
    if there:
        raise InputError(f"new {what} {name}: {', '.join(there)} is there already and is kept")
    out.mkdir(parents=True, exist_ok=True)
    for path, template in wanted.items():
        path.write_text(
            template.read_text(encoding="utf-8").replace("NAME", name), encoding="utf-8"
        )
    return list(wanted)
