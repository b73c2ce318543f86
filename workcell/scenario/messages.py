"""Validation errors in the words of the file: dotted key, value, and what is allowed."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ValidationError

from workcell.scenario.schema import KINDS, Scenario


def messages(error: ValidationError, content: dict[str, Any]) -> list[str]:
    """One line for each fault of a validation, `content` being what the file holds."""
    return [_fault(item, content) for item in _roots(error.errors())]


def _roots(items: list[Any]) -> list[Any]:
    """Leave out 'too few entries' where entries are missing only because they are at fault themselves."""
    locations = [item["loc"] for item in items]
    return [
        item
        for item in items
        if item["type"] != "too_short"
        or not any(
            len(loc) > len(item["loc"]) and loc[: len(item["loc"])] == item["loc"]
            for loc in locations
        )
    ]


def _fault(item: Any, content: dict[str, Any]) -> str:
    """One validation error in the words of the file: dotted key, value, what is allowed."""
    key: list[str] = []
    node: Any = content
    for part in item["loc"]:
        if isinstance(node, dict) and part in node:
            node = node[part]
            key.append(str(part))
        elif isinstance(node, (list, tuple)) and isinstance(part, int) and part < len(node):
            node = node[part]
            key.append(str(node.get("name", part)) if isinstance(node, dict) else str(part))
        elif item["type"] == "missing":
            key.append(str(part))
    name = ".".join(key) or "scenario"
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "missing":
        return f"{name}: this key is missing and has no default"
    if item["type"] == "extra_forbidden":
        return f"{name} = {node!r}: unknown key; allowed here: {', '.join(_allowed(item['loc']))}"
    if isinstance(node, dict):
        return f"{name}: {message}"
    return f"{name} = {node!r}: {message}"


def _allowed(location: tuple[Any, ...]) -> list[str]:
    """The keys allowed in the table that holds the unknown key at `location`."""
    node: Any = Scenario
    for part in location[:-1]:
        if isinstance(part, int):
            continue
        node = KINDS.get(part) or _table_of(node, part)
    return sorted(node.model_fields)


def _table_of(table: Any, key: str) -> Any:
    """The model class behind a key, seen through tuples, unions and annotations."""
    return _first_table(table.model_fields[key].annotation) or table


def _first_table(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        found = _first_table(inner)
        if found:
            return found
    return None
