"""The command line: what people type, and nothing else.

Exit status 0: done, and everything expected held. 1: it ran, but a collision, an unexpected halt or
an unmet expectation. 2: the input was refused, with a message that names file, key, value and what
is allowed.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Sequence

import tyro

import workcell
from workcell.cli import (
    arms,
    films,
    install,
    judge,
    live,
    new,
    place,
    plugged,
    race,
    regression,
    reports,
    run,
    scenarios,
    show,
    studies,
)
from workcell.cli.boundary import guarded
from workcell.cli.terminal import OK, stdout
from workcell.errors import InputError, did_you_mean, shown

COMMANDS: dict[str, Callable[..., int]] = {
    "list": scenarios.list_,
    "import": arms.import_,
    "check": scenarios.check,
    "place": place.place,
    "run": run.run,
    "teleop": live.teleop,
    "record-operator": live.record_operator,
    "judge": judge.judge,
    "replay": show.replay,
    "plot": show.plot,
    "report": reports.report,
    "film": films.film,
    "sweep": studies.sweep,
    "falsify": studies.falsify,
    "race": race.race,
    "compare": regression.compare,
    "reproduce": regression.reproduce,
    "bless": regression.bless,
    "salvage": regression.salvage,
    "new": new.new,
    "plugins": plugged.plugins_,
    "compile": install.compile_,
}
"""Every command by the name that people type."""
OLD_NAMES: dict[str, Callable[..., int]] = {"rerun": regression.rerun}
"""Commands under names that they had before; they say so."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the `workcell` command; returns the exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A path need not be text; what cannot be written in the terminal's encoding becomes an escape.
            stream.reconfigure(errors="backslashreplace")
    given = list(sys.argv[1:] if arguments is None else arguments)
    return guarded(lambda: _dispatch(plugged.take_files(given)))


def _dispatch(given: list[str]) -> int:
    """Find the command and call it."""
    commands = COMMANDS | OLD_NAMES
    if given == ["--version"]:
        stdout.print(f"workcell {workcell.__version__}")
        return OK
    if given and given[0] not in (*commands, "--help", "-h"):
        near = did_you_mean(given[0], COMMANDS)
        raise InputError(
            f"no such command: {shown(given[0])}{near or '; allowed: ' + ', '.join(COMMANDS)}"
        )
    return tyro.extras.subcommand_cli_from_dict(
        commands, prog="workcell", args=given, description=__doc__
    )


if __name__ == "__main__":
    sys.exit(main())
