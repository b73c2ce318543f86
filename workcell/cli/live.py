"""The commands with a person at an arm: teleop, record-operator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from workcell import scenario as scenario_file
from workcell.cli.options import Overrides, RunFolder, ScenarioName
from workcell.cli.terminal import FAILED, OK, report, stdout


def teleop(
    scenario: ScenarioName,
    /,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help="run folder; default runs/<scenario>_live")
    ] = None,
    set: Overrides = (),
    gamepad: Annotated[
        bool, tyro.conf.arg(help="steer with the first gamepad or 3D mouse too")
    ] = False,
    rerun: Annotated[
        bool, tyro.conf.arg(help="also stream to a rerun viewer on this machine, when there is one")
    ] = False,
) -> int:
    """Run a scenario in real time with a person at its live operators; docs/teleop.md has the keys."""
    from workcell.live.teleop import teleop as session

    loaded = scenario_file.load(scenario, set)
    folder = out or Path("runs") / f"{loaded.name}_live"
    summary = session(loaded, folder, gamepad=gamepad, rerun=rerun, say=stdout.print)
    report(summary, folder)
    kept = summary["real_time"]
    stdout.print(
        f"real time: {kept['missed']} of {kept['ticks']} ticks came late, the worst by {1e3 * kept['worst_late_s']:.1f} ms; {kept['slipped_s']:.2f} s slower than the clock"
    )
    return OK if summary["held"] else FAILED


def record_operator(run: RunFolder, /) -> int:
    """Write the operators of a run as recordings, and replay.toml, which plays them back."""
    from workcell.live.operator_file import write_replay

    for path in write_replay(run):
        stdout.print(str(path))
    return OK
