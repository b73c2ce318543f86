"""The command that prepares this machine: compile."""

from __future__ import annotations

from workcell.cli.terminal import FAILED, OK, stderr, stdout


def compile_() -> int:
    """Compile the arithmetic of a tick for this machine, once; without it, NumPy is used and a tick takes twice as long."""
    from workcell.control.kernels.build import compile_kernels

    try:
        stdout.print(str(compile_kernels()))
    except OSError as error:
        stderr.print(f"cannot keep what was compiled: {error}", markup=False)
        return FAILED
    return OK
