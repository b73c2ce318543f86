"""The commands with a person at an arm: teleop, record-operator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from workcell import scenario as scenario_file
from workcell.cli.options import Overrides, RunFolder, ScenarioName
from workcell.cli.terminal import FAILED, OK, stderr, stdout


def teleop(
    scenario: ScenarioName,
    /,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help="run folder; default runs/<scenario>_live")
    ] = None,
    set: Overrides = (),
    port: Annotated[
        int | None, tyro.conf.arg(metavar="N", help="of the page; default 8080, 0 for any free one")
    ] = None,
    window: Annotated[
        bool, tyro.conf.arg(help="MuJoCo's window on this machine's display, instead of the page")
    ] = False,
    gamepad: Annotated[
        bool,
        tyro.conf.arg(help="with --window: drive with the first gamepad or 3D mouse too"),
    ] = False,
    rerun: Annotated[
        bool, tyro.conf.arg(help="also stream to a rerun viewer on this machine, when there is one")
    ] = False,
) -> int:
    """Run a scenario in real time with a person at its live operators: a page in the browser shows the cell and takes mouse, keys and gamepad."""
    from workcell.live.teleop import NOT_DRIVEN
    from workcell.live.teleop import teleop as session

    loaded = scenario_file.load(scenario, set)
    sessions = session(
        loaded,
        out or Path("runs") / f"{loaded.name}_live",
        window=window,
        port=port,
        gamepad=gamepad,
        rerun=rerun,
        asked_for=[key.partition("=")[0] for key in set],
        say=lambda line: stdout.print(line, markup=False),
    )
    if not sessions:
        stdout.print(NOT_DRIVEN)
    for run in sessions:
        stdout.print(f"{run.folder}:", markup=False)
        for line in run.report.lines():
            stdout.print(f"  {line}", markup=False)
        kept = run.summary["real_time"]
        stdout.print(
            f"  {kept['missed']} of {kept['ticks']} ticks came late, the worst by {1e3 * kept['worst_late_s']:.1f} ms; {kept['slipped_s']:.2f} s slower than the clock."
        )
        if run.summary["metrics"]["fault"]:
            stderr.print(f"stopped: {run.summary['metrics']['fault']}", markup=False)
    # A person's session is not held against a script's expectations; a fault of the program is one.
    return FAILED if any(run.summary["metrics"]["fault"] for run in sessions) else OK


def record_operator(run: RunFolder, /) -> int:
    """Write the operators of a run as recordings, and replay.toml, which plays them back."""
    from workcell.live.operator_file import write_replay

    for path in write_replay(run):
        stdout.print(str(path))
    return OK
