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

from workcell.cli import (
    arms,
    films,
    install,
    judge,
    live,
    regression,
    reports,
    run,
    scenarios,
    show,
    studies,
)
from workcell.cli.boundary import guarded

COMMANDS: dict[str, Callable[..., int]] = {
    "list": scenarios.list_,
    "import": arms.import_,
    "check": scenarios.check,
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
    "compare": regression.compare,
    "reproduce": regression.reproduce,
    "bless": regression.bless,
    "salvage": regression.salvage,
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
    return guarded(
        lambda: tyro.extras.subcommand_cli_from_dict(
            COMMANDS | OLD_NAMES, prog="workcell", args=arguments, description=__doc__
        )
    )


if __name__ == "__main__":
    sys.exit(main())
