"""`KEY=VALUE` overrides of a parsed scenario file.

A key is dotted. An entry of a list is addressed by its name or its place (`arm.nurse.job.0.dwell_s=1`).
A value is TOML or, failing that, a plain string.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from workcell.errors import InputError
from workcell.scenario.schema import KINDS


def apply(content: dict[str, Any], override: str, path: Path) -> None:
    """Set one dotted key in the parsed file."""
    key, separator, text = override.partition("=")
    if not separator or not key:
        raise InputError(
            f"--set {override!r}: allowed is KEY=VALUE with a dotted key of the scenario file",
            file=path,
        )
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    node: Any = content
    *parents, last = key.split(".")
    for part in parents:
        node = _descend(node, part, key, path)
    if isinstance(node, list):
        raise InputError(
            f"--set {key}: {last!r} would replace one of several entries; name a key inside it",
            file=path,
        )
    if parents[-1:] == ["operator"] and last in _KIND_OF:
        here = Path(str(value))
        # What is seen from the working folder is meant, any other path is relative to the scenario.
        _become(node, _KIND_OF[last], **{last: str(here.resolve() if here.exists() else here)})
    elif parents[-1:] == ["operator"] and last == "kind":
        _become(node, str(value))
    else:
        node[last] = value


_KIND_OF = {"file": "recording", "run": "joints"}
"""Keys of an operator that say by themselves of which kind it is."""


def _become(operator: dict[str, Any], kind: str, **settings: Any) -> None:
    """Turn a table into an operator of a kind; keys that kind does not have go with the old one."""
    table = KINDS.get(kind)
    kept = {key: x for key, x in operator.items() if table is None or key in table.model_fields}
    operator.clear()
    operator.update(kept | settings, kind=kind)


def _descend(node: Any, part: str, key: str, path: Path) -> Any:
    if isinstance(node, dict):
        node = node.setdefault(part, {})
        if isinstance(node, (dict, list)):
            return node
        raise InputError(f"--set {key}: {part!r} is a value, not a table", file=path)
    names = [str(item.get("name", index)) for index, item in enumerate(node)]
    if part in names:
        return node[names.index(part)]
    if part.isdecimal() and int(part) < len(node):
        return node[int(part)]
    raise InputError(f"--set {key}: no entry {part!r}; allowed: {', '.join(names)}", file=path)
