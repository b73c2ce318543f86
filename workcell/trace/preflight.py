"""Can the run folder take what the run will write? Asked before the run, not after an hour of it.

Comes in: the folder, the columns and the number of ticks. The journal holds every value in full and is
still there while the parquet file is written from it; that file and the recording are smaller.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

from workcell.errors import InputError
from workcell.signals import Layout, columns

SCALAR_BYTES = 16
"""Room for a scalar: eight bytes of number, or a short text with its offset."""
COPIES = 2
"""Journal and parquet file side by side; the recording fits in what compression leaves of the latter."""


def check_writable(folder: Path) -> None:
    """Refuse a folder that cannot be written to.

    Raises:
        InputError: naming the folder and the system's reason.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Only a write shows what rights, a read-only disk or a full one would show later.
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"\0" * 4096)
    except OSError as error:
        raise InputError(f"the run folder cannot be written to: {error}", file=folder) from error


def remove_earlier(folder: Path, names: Sequence[str]) -> None:
    """Remove what an earlier run left in a folder, before the new one writes its first file.

    A run that is killed must not keep the summary of the run before it.

    Args:
        folder: The run folder.
        names: Files and folders of a run, in it.

    Raises:
        InputError: One of them cannot be removed.
    """
    for name in names:
        path = folder / name
        try:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
        except OSError as error:
            raise InputError(
                f"what an earlier run left cannot be removed: {error}", file=path
            ) from error


def check_space(folder: Path, layout: Layout, ticks: int) -> None:
    """Refuse a disk that is too full for a trace.

    Raises:
        InputError: naming what is needed and what is free.
    """
    needed, free = COPIES * ticks * row_bytes(layout), shutil.disk_usage(folder).free
    if free < needed:
        raise InputError(
            f"the disk is too full: {ticks} ticks need {needed / 1e6:.0f} MB, {free / 1e6:.0f} MB are "
            "free; make room, choose another folder with --out, or a shorter simulation.duration_s",
            file=folder,
        )


def row_bytes(layout: Layout) -> int:
    """Bytes of one tick in the journal."""
    return sum(
        SCALAR_BYTES if column.width is None else 8 * column.width + SCALAR_BYTES
        for column in columns(layout)
    )
