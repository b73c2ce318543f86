"""The command that searches where arms must stand: place."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated, Literal

import tyro

from workcell import assets
from workcell import scenario as scenario_file
from workcell.cli.options import Overrides, ScenarioName
from workcell.cli.terminal import FAILED, OK, stderr, stdout
from workcell.errors import InputError


def place(
    scenario: ScenarioName,
    /,
    search: Annotated[
        Literal["base", "home", "both"],
        tyro.conf.arg(help="what may be changed; both tries the base alone first"),
    ] = "both",
    evaluations: Annotated[
        int, tyro.conf.arg(metavar="N", help="rehearsals of a search at most")
    ] = 600,
    out: Annotated[
        Path | None,
        tyro.conf.arg(metavar="FILE", help="default SCENARIO_placed.toml beside the scenario"),
    ] = None,
    set: Overrides = (),
) -> int:
    """Search bases and homes from which the arms can do their jobs: every pose within reach and clear."""
    from workcell.admission import admit
    from workcell.scenario.rewrite import rewrite, toml_text
    from workcell.study import place as study

    if evaluations < 1:
        raise InputError(f"--evaluations {evaluations}: allowed is 1 or more")
    source = scenario_file.find(scenario)
    asked = scenario_file.load(scenario, set)
    shipped = scenario in assets.scenario_names()
    target = out or (Path() if shipped else source.parent) / f"{source.stem}_placed.toml"
    if target.resolve() == source.resolve():
        raise InputError(f"--out {target}: is the scenario itself; choose another file")
    moves = study.place(asked, search=search, evaluations=evaluations, say=stderr.print)
    values = {}
    for move in moves:
        found = {
            "base_position_m": move.position_m,
            "base_wxyz": move.wxyz,
            "home_rad": move.home_rad,
        }
        values[move.arm] = {key: x for key, x in found.items() if x is not None}
        stdout.print(f"arm.{move.arm}: {toml_text(values[move.arm]) or 'stays where it is'}")
    missing = [move for move in moves if not move.after.fits]
    for move in missing:
        stdout.print(f"arm.{move.arm}: no place found: {study.told(move.after)}")
    placed = rewrite(asked, source, target, values)
    stdout.print(str(target))
    try:
        with tempfile.TemporaryDirectory() as folder:
            admit(placed, Path(folder))
    except InputError as error:
        stdout.print(f"cannot be run as it is: {error}")
        return FAILED
    if missing:
        return FAILED
    stdout.print(f"can be run: workcell run {target}")
    return OK
