"""What only some commands need, and how to install it."""

from __future__ import annotations

from importlib.util import find_spec

from workcell.errors import InputError


def needs(module: str, extra: str) -> None:
    """Refuse a command whose library is not installed.

    Args:
        module: What is imported.
        extra: The extra of this package that brings it.

    Raises:
        InputError: Naming what to install.
    """
    if find_spec(module) is None:
        raise InputError(f"needs {module}; install it with: pip install 'ttc-workcell[{extra}]'")
