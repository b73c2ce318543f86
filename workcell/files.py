"""Reading files that others may have changed: a device or a pipe would be read without end, and is refused."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any


class NoFile(OSError):
    """A path is neither a file nor a folder, but a device, a pipe or a socket."""


def read_text(path: Path) -> str:
    """The text of a file.

    Raises:
        NoFile: it is no file.
        OSError: it cannot be read.
        UnicodeDecodeError: it is no text.
    """
    require_file(path)
    return path.read_text(encoding="utf-8")


def read_object(path: Path) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        NoFile: it is no file.
        OSError: it cannot be read.
        ValueError: it is no JSON, or another value than an object.
    """
    found = json.loads(read_text(path))
    if not isinstance(found, dict):
        raise ValueError(f"holds a {type(found).__name__}; allowed is a JSON object")
    return found


def require_files(folder: Path) -> None:
    """Look through a folder before a library reads what is in it.

    Raises:
        NoFile: something in it is neither a file nor a folder.
    """
    for root, _, names in os.walk(folder):
        for name in names:
            require_file(Path(root) / name)


def require_file(path: Path) -> None:
    """Look at a path before a library reads it; that it exists is for the library to say.

    Raises:
        NoFile: it is neither a file nor a folder.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise NoFile(
            f"{path}: is no file but a device, pipe or socket; it would be read without end"
        )
