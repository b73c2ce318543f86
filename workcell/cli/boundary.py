"""The one place where an error becomes an exit status and a message.

Our own errors say what was at fault. Errors of the file system, of Arrow, MuJoCo and dm_control that come up
here are the input's too: what reads a file wraps them where it knows the key at fault, and what it
forgets is told here by the library's own words. Everything else is a fault of this program and keeps its
traceback.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from workcell.cli.terminal import FAILED, REFUSED, stderr
from workcell.errors import (
    MESSAGE_LENGTH,
    InputError,
    TraceError,
    printable,
    reason,
    shortened,
)

LIBRARIES = {
    "dm_control": ("Error",),
    "lxml.etree": ("LxmlError",),
    "mujoco": ("FatalError", "UnexpectedError"),
    "pyarrow": ("ArrowException",),
    "pydantic": ("ValidationError",),
}
"""Kinds of error that only an input causes, by the module that has them; looked up where it is loaded already."""


def guarded(command: Callable[[], int]) -> int:
    """Run a command; its exit status, or that of the error it ended with."""
    try:
        return command()
    except (InputError, TraceError) as error:
        _say(str(error))
        return REFUSED
    except KeyboardInterrupt:
        _say("interrupted")
        return FAILED
    except BrokenPipeError:
        # Whoever read our output has read enough; what is left is not tried again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except (OSError, MemoryError, UnicodeError, *_of_libraries()) as error:
        _say(f"cannot go on: {reason(error)}")
        return REFUSED


def _of_libraries() -> tuple[type[BaseException], ...]:
    kinds: list[type[BaseException]] = []
    for module, names in LIBRARIES.items():
        if module in sys.modules:
            kinds += [
                kind
                for name in names
                if isinstance(kind := getattr(sys.modules[module], name, None), type)
            ]
    return tuple(kinds)


def _say(message: str) -> None:
    lines = [printable(line) for line in message.split("\n")]
    stderr.print(shortened("\n".join(lines), MESSAGE_LENGTH))
