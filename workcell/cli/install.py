"""The command that prepares this machine: compile."""

from __future__ import annotations

from workcell.cli.terminal import FAILED, OK, stderr, stdout


def compile_() -> int:
    """Compile the laws of a tick for this machine, once; otherwise their first use does so, which takes a minute."""
    try:
        from workcell.control.warm import warm

        stdout.print(str(warm()))
    except OSError as error:
        stderr.print(f"cannot keep what was compiled: {error}")
        return FAILED
    return OK
