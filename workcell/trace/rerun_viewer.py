"""Where the rerun viewer's program is: it shows recordings, and merges what is left of a damaged one."""

from __future__ import annotations

import os
from pathlib import Path

import rerun_cli


def viewer_binary() -> Path:
    """The viewer inside the installed package: the `rerun` script is a shim it would outlive."""
    return Path(rerun_cli.__file__).with_name("rerun" + (".exe" if os.name == "nt" else ""))
