"""Arms of libraries: `menagerie:NAME` and `robot_descriptions:NAME`, adapted once into the user's cache.

The libraries download and cache by themselves; they are extras. What was adapted is kept under a hash of
the arm's files and of the versions that adapted it, so that neither can change unnoticed.
"""

from __future__ import annotations

import hashlib
import importlib
import os
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType

import mujoco

from workcell.assets import LIBRARY_PREFIXES
from workcell.errors import InputError
from workcell.scene.adapt.adapt import Wishes, adapt
from workcell.scene.content import digest

MENAGERIE, DESCRIPTIONS = LIBRARY_PREFIXES
_EXTRA = "pip install 'ttc-workcell[arms]'"


def adapted_file(model: str, cache: Path | None = None) -> Path:
    """The adapted arm file of a library's arm.

    Args:
        model: `menagerie:NAME` or `robot_descriptions:NAME`.
        cache: Where adapted arms are kept; default the user's cache folder.

    Raises:
        InputError: the library is not installed or does not know the name, or the arm cannot be adapted.
    """
    prefix, name = model.split(":", 1)
    source = _of_menagerie(name) if f"{prefix}:" == MENAGERIE else _of_descriptions(name)
    parts = (model, digest(source), mujoco.__version__, _own_version())
    key = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
    folder = (cache or _cache()) / key
    path = folder / f"{name}.xml"
    if not path.is_file():
        text = adapt(source, Wishes(name=name)).xml
        folder.mkdir(parents=True, exist_ok=True)
        fresh = folder / f"{name}.{os.getpid()}.part"
        fresh.write_text(text, encoding="utf-8")
        # Another process may adapt the same arm now; both write the same bytes.
        fresh.replace(path)
    return path


def _cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "workcell" / "arms"


def _own_version() -> str:
    try:
        return version("ttc-workcell")
    except PackageNotFoundError:
        return "unknown"


def _imported(module: str, model: str) -> ModuleType:
    package = module.partition(".")[0]
    try:
        importlib.import_module(package)
    except ModuleNotFoundError as error:
        raise InputError(f"{model!r}: the package {package} is not installed; {_EXTRA}") from error
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise InputError(f"{model!r}: {package} knows no such arm") from error


def _of_menagerie(name: str) -> Path:
    library = _imported("mujoco_menagerie", MENAGERIE + name)
    if name not in library.names():
        arms = [robot.name for robot in library.robots("arm")]
        raise InputError(f"{MENAGERIE + name!r}: no such robot; its arms are {', '.join(arms)}")
    robot = library.get(name)
    try:
        return Path(robot.xml(robot.default_model))
    except library.MenagerieError as error:
        raise InputError(f"{MENAGERIE + name!r}: {error}") from error


def _of_descriptions(name: str) -> Path:
    if not name.isidentifier() or name.startswith("_"):
        # A scenario names it: nothing else of the package is imported for a stranger's file.
        raise InputError(f"{DESCRIPTIONS + name!r}: {name!r} is no name of a description")
    module = _imported(f"robot_descriptions.{name}", DESCRIPTIONS + name)
    for attribute in ("MJCF_PATH", "URDF_PATH"):
        if hasattr(module, attribute):
            return Path(getattr(module, attribute))
    raise InputError(f"{DESCRIPTIONS + name!r}: has neither an MJCF nor a URDF file")
