"""What an arm file consists of: itself, what it includes, and the meshes and textures it names.

Comes in: a path. Goes out: a digest of the content of all of these, so that what was made from an
arm file can be kept for as long as nothing of it has changed, whatever its dates say.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from lxml import etree

from workcell.errors import InputError

MOST_BYTES = 500_000_000
"""Of an arm file and all it names; chosen ten times the largest published arm."""
_FOLDER_KEYS = ("meshdir", "texturedir", "assetdir")


def digest(path: Path) -> str:
    """SHA-256 over path and content of the file and of every file it names, and of those they name.

    A name counts in each folder where it could be meant: reading too many files does no harm.

    Raises:
        InputError: a device is named, or the files are larger together than any arm's.
    """
    total = hashlib.sha256()
    seen: set[Path] = set()
    read = 0
    waiting = [path]
    while waiting:
        file = waiting.pop()
        if file in seen:
            continue
        seen.add(file)
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise InputError(
                f"names {str(file)!r}, which is no file but a device or pipe; it would be read without end"
            )
        if file.is_file():
            read += file.stat().st_size
        if read > MOST_BYTES:
            raise InputError(
                f"its files have more than {MOST_BYTES:,} bytes together; no arm needs so many"
            )
        content = file.read_bytes() if file.is_file() else None
        # The length tells where a name or a content ends.
        for part in (str(file).encode(), content or b""):
            total.update(b"%d:" % len(part) + part)
        total.update(b"missing" if content is None else b"there")
        if content is not None and (file == path or file.suffix == ".xml"):
            waiting += sorted(set(_named_in(content, file.parent)))
    return total.hexdigest()


def _named_in(content: bytes, folder: Path) -> Iterator[Path]:
    try:
        elements = list(etree.fromstring(content).iter(etree.Element))
    except etree.XMLSyntaxError:
        return  # MuJoCo will say what is wrong with it.
    folders = {""} | {element.get(key, "") for element in elements for key in _FOLDER_KEYS}
    for element in elements:
        for key, name in element.attrib.items():
            if str(key).startswith("file"):
                yield from (folder / inner / str(name) for inner in folders)
