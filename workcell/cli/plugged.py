"""Plug-ins at the command line: `--plugin FILE` of every command, and the command that lists them."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from workcell import plugins
from workcell.cli.terminal import OK, stdout
from workcell.errors import InputError

OPTION = "--plugin"


def take_files(arguments: Sequence[str]) -> list[str]:
    """Take every `--plugin FILE` out of a command line and load it.

    Returns:
        The rest.

    Raises:
        InputError: A file cannot be used, or none is named.
    """
    rest, files = [], []
    words = iter(arguments)
    for word in words:
        if word == OPTION:
            file = next(words, None)
            if file is None:
                raise InputError(f"{OPTION}: names no file")
            files.append(file)
        elif word.startswith(OPTION + "="):
            files.append(word.removeprefix(OPTION + "="))
        else:
            rest.append(word)
    plugins.use_files(files)
    return rest


def plugins_() -> int:
    """List the strategies, criteria, operators and devices that a scenario may name, and where each comes from."""
    table = Table("kind", "name", "from", "version", box=None)
    for kind in plugins.KINDS:
        for plugin in plugins.known(kind).values():
            table.add_row(plugins.SINGULAR[kind], plugin.name, plugin.source, plugin.version)
    stdout.print(table, markup=False)
    return OK
