"""The command line: what people type, and nothing else.

Exit status 0: done, and everything expected held. 1: it ran, but a collision, an unexpected halt or
an unmet expectation. 2: the input was refused, with a message that names file, key, value and what
is allowed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import tyro

from workcell.cli import install, live, regression, run, scenarios, show, studies
from workcell.cli.terminal import FAILED, REFUSED, stderr
from workcell.errors import InputError, TraceError

COMMANDS: dict[str, Callable[..., int]] = {
    "list": scenarios.list_,
    "check": scenarios.check,
    "run": run.run,
    "teleop": live.teleop,
    "record-operator": live.record_operator,
    "replay": show.replay,
    "plot": show.plot,
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
    try:
        return tyro.extras.subcommand_cli_from_dict(
            COMMANDS | OLD_NAMES, prog="workcell", args=arguments, description=__doc__
        )
    except (InputError, TraceError) as error:
        stderr.print(str(error), markup=False)
        return REFUSED
    except KeyboardInterrupt:
        stderr.print("interrupted")
        return FAILED


if __name__ == "__main__":
    sys.exit(main())
