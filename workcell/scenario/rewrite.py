"""New values for keys of `[[arm]]` tables in the text of a scenario file; all else, comments too, stays as it is.

The text is changed line by line and read again. Where that does not give what was meant (inline tables, paths that
are relative to another folder), the resolved scenario is written instead, which has no comments.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from workcell.errors import InputError
from workcell.scenario.load import load
from workcell.scenario.schema import Scenario

_ARM = re.compile(r"^\s*\[\[\s*arm\s*\]\]\s*(#.*)?$")
_TABLE = re.compile(r"^\s*\[")

Values = Mapping[str, Mapping[str, tuple[float, ...]]]
"""By arm and key."""


def rewrite(asked: Scenario, source: Path, target: Path, values: Values) -> Scenario:
    """Write a scenario with new values for some keys of its arms.

    Args:
        asked: What was read from the source; overrides of the command line are kept.
        source: Its file.
        target: Where to.
        values: Lists of numbers, by arm and key.

    Returns:
        The scenario as it is read from the target.

    Raises:
        InputError: the target cannot be written.
    """
    content = asked.model_dump(mode="json")
    for arm in content["arm"]:
        arm |= {key: list(numbers) for key, numbers in values.get(arm["name"], {}).items()}
    wanted = Scenario.model_validate(content)
    try:
        target.write_text(_edited(source, asked, values), encoding="utf-8")
        if not _says(target, wanted):
            target.write_text(wanted.to_toml(), encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=target) from error
    return load(target)


def _says(path: Path, wanted: Scenario) -> bool:
    """Whether a file reads as a scenario; a scenario without a name of its own is called as its file."""
    try:
        found = load(path)
    except InputError:
        return False
    return found.model_copy(update={"name": wanted.name}).digest() == wanted.digest()


def _edited(source: Path, asked: Scenario, values: Values) -> str:
    """The text with the new values, so far as arms have tables of their own."""
    lines = source.read_text(encoding="utf-8").splitlines()
    heads = [k for k, line in enumerate(lines) if _ARM.match(line)]
    if len(heads) != len(asked.arm):
        return ""
    for head, arm in reversed(list(zip(heads, asked.arm, strict=True))):
        for key, numbers in values.get(arm.name, {}).items():
            lines = list(_with_key(lines, head, key, numbers))
    return "\n".join(lines) + "\n"


def _with_key(lines: list[str], head: int, key: str, numbers: tuple[float, ...]) -> Iterator[str]:
    """The lines with one key of the table that begins at `head` set: in its place, else below the name."""
    text = f"{key} = [{', '.join(f'{x:.9g}' for x in numbers)}]"
    end = next((k for k in range(head + 1, len(lines)) if _TABLE.match(lines[k])), len(lines))
    start = re.compile(rf"^\s*{key}\s*=")
    first = next((k for k in range(head + 1, end) if start.match(lines[k])), None)
    if first is None:
        yield from lines[: head + 2]
        yield text
        yield from lines[head + 2 :]
        return
    last = first
    while "".join(lines[first : last + 1]).count("[") > "".join(lines[first : last + 1]).count("]"):
        last += 1
    comment = re.search(r"\]\s*(#.*)$", lines[last])
    yield from lines[:first]
    yield text + (f"  {comment.group(1)}" if comment else "")
    yield from lines[last + 1 :]


def toml_text(values: Mapping[str, Any]) -> str:
    """Keys and lists of numbers as they are written, for a message."""
    return ", ".join(f"{k} = [{', '.join(f'{x:g}' for x in v)}]" for k, v in values.items())
