"""What an arm file consists of: itself, what it includes, and the meshes and textures it names.

Comes in: a path. Goes out: a digest of the content of all of these, so that what was made from an
arm file can be kept for as long as nothing of it has changed, whatever its dates say.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from pathlib import Path

from lxml import etree

from workcell.errors import InputError, shown

MOST_BYTES = 500_000_000
"""Of an arm file and all it names; chosen ten times the largest published arm."""
MOST_MADE = {
    ("replicate", ("count",)): 1000,
    ("composite", ("count",)): 1000,
    ("flexcomp", ("count",)): 1000,
    ("numeric", ("size",)): 10_000,
    ("hfield", ("nrow", "ncol")): 1_000_000,
    ("texture", ("width", "height")): 100_000_000,
}
"""What one short line may ask MuJoCo to make, by element and the attributes whose product counts; each chosen far above
any arm's. MuJoCo makes a hundred thousand copies in 20 minutes, in one call that nothing interrupts."""
_FOLDER_KEYS = ("meshdir", "texturedir", "assetdir")


def digest(path: Path) -> str:
    """SHA-256 over path and content of the file and of every file it names, and of those they name.

    A name counts in each folder where it could be meant: reading too many files does no harm.

    Raises:
        InputError: a device is named, the files are larger together than any arm's, or a line asks for more
            copies than any arm has.
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
    for element in elements:
        _refuse_endless(element)
    folders = {""} | {element.get(key, "") for element in elements for key in _FOLDER_KEYS}
    for element in elements:
        for key, name in element.attrib.items():
            if str(key).startswith("file"):
                yield from (folder / inner / str(name) for inner in folders)


def _refuse_endless(element: etree._Element) -> None:
    """Refuse what would take MuJoCo minutes to make."""
    for (tag, keys), most in MOST_MADE.items():
        if element.tag != tag:
            continue
        # Copies of copies: those around it count too.
        made = _product(element, keys) * math.prod(
            _product(outer, keys) for outer in element.iterancestors(tag)
        )
        if made > most:
            said = " ".join(f"{key}={shown(element.get(key))}" for key in keys)
            raise InputError(
                f"<{tag} {said}> in line {element.sourceline} asks for {made:.6g}; allowed are {most:,}"
            )


def _product(element: etree._Element, keys: tuple[str, ...]) -> float:
    """Of the numbers in some attributes; what is no number MuJoCo will refuse itself."""
    try:
        return math.prod(float(x) for key in keys for x in element.get(key, "1").split())
    except ValueError:
        return 1.0
