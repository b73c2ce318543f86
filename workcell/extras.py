"""Optional libraries: named where they are missing, with the extra that brings them."""

from __future__ import annotations

import importlib
from types import ModuleType

from workcell.errors import InputError

DISTRIBUTION = "ttc-workcell"
"""Name to install by; `workcell` on the public index is another project."""


def need(module: str, *, extra: str, what: str) -> ModuleType:
    """Import an optional library.

    Args:
        module: Its name, as imported.
        extra: The extra of this distribution that brings it.
        what: What needs it, as it should read in the message (`workcell plot`).

    Raises:
        InputError: It is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(
            f"{what} needs {module}, which is not installed; pip install '{DISTRIBUTION}[{extra}]'"
        ) from error
