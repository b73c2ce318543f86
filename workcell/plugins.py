"""What others bring: strategies, criteria, operators and devices, found by name.

Built-in ones are listed here by the place they are loaded from. Others come from installed packages
(entry points in the groups `workcell.strategies`, `workcell.criteria`, `workcell.operators` and
`workcell.devices`) or from files named with `--plugin` on the command line. A scenario file only ever
holds names: opening a stranger's scenario runs no stranger's code.

A plug-in file is a Python file that sets one dictionary a kind: `STRATEGIES = {"mine": Mine}`, and so
on for `CRITERIA`, `OPERATORS`, `DEVICES`.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from workcell.errors import InputError, did_you_mean

Kind = Literal["strategies", "criteria", "operators", "devices"]
KINDS: tuple[Kind, ...] = ("strategies", "criteria", "operators", "devices")
SINGULAR: dict[str, str] = {
    "strategies": "strategy",
    "criteria": "criterion",
    "operators": "operator",
    "devices": "device",
}
FILES_VARIABLE = "WORKCELL_PLUGINS"
"""Environment variable with the files given by `--plugin`, so that the processes of a study have them too."""

_STRATEGIES = "workcell.control.strategies"
_CRITERIA = "workcell.control.laws.criteria"
BUILT_IN: dict[Kind, dict[str, str]] = {
    "strategies": {
        "ttc": f"{_STRATEGIES}.ttc:TtcStrategy",
        "paper_scaling": f"{_STRATEGIES}.paper_scaling:PaperScaling",
        "distance": f"{_STRATEGIES}.distance:Distance",
        "ssm": f"{_STRATEGIES}.ssm:Ssm",
        "velocity_damper": f"{_STRATEGIES}.velocity_damper:VelocityDamper",
        "cbf": f"{_STRATEGIES}.cbf:Cbf",
        "joint_qp": f"{_STRATEGIES}.joint_qp:JointQp",
        "mink_limit": f"{_STRATEGIES}.mink_limit:MinkLimit",
        "potential_field": f"{_STRATEGIES}.potential_field:PotentialField",
    },
    "criteria": {
        "artc": f"{_CRITERIA}:ARTC_SIGNED",
        "artc_approaching": f"{_CRITERIA}:ARTC_APPROACHING",
        "armd": f"{_CRITERIA}:ARMD",
        "none": f"{_CRITERIA}:NO_CRITERION",
        "artc_held": f"{_CRITERIA}:ARTC_HELD",
    },
    "operators": {},
    "devices": {},
}
"""Names and where they are loaded from; a criterion of our own is a number by which the laws know it."""


@dataclass(frozen=True)
class Plugin:
    """One thing that can be named in a scenario."""

    kind: Kind
    name: str
    source: str
    """`built in`, the distribution that brings it, or the file."""
    version: str
    """Of the distribution, or a hash of the file; empty for what is built in."""
    target: str
    """`module:attribute`, or the file."""


def known(kind: Kind) -> dict[str, Plugin]:
    """All plug-ins of a kind by their name; nothing of theirs is imported, but for files that were named by hand.

    Raises:
        InputError: Two of them have one name.
    """
    found = {
        name: Plugin(kind, name, "built in", "", target) for name, target in BUILT_IN[kind].items()
    }
    for plugin in [*_installed(kind), *_of_files(kind)]:
        other = found.get(plugin.name)
        if other is not None:
            raise InputError(
                f"{SINGULAR[kind]} {plugin.name!r} is brought twice: by {other.source} and by {plugin.source}"
            )
        found[plugin.name] = plugin
    return found


def is_built_in(kind: Kind, name: str) -> bool:
    """Whether a name is one of this package's own."""
    return name in BUILT_IN[kind]


def built_in(kind: Kind) -> dict[str, Any]:
    """What stands behind the built-in names of a kind, without a look at what others bring.

    A module that a plug-in imports may ask for it while that plug-in is being imported.
    """
    return {
        name: EntryPoint(name, target, f"workcell.{kind}").load()
        for name, target in BUILT_IN[kind].items()
    }


def load(kind: Kind, name: str) -> Any:
    """What stands behind a name.

    Raises:
        InputError: There is no such plug-in, or it cannot be imported; the message names it.
    """
    plugin = find(kind, name)
    try:
        if plugin.target in files():
            return _file(plugin.target)[kind][name]
        return EntryPoint(name, plugin.target, f"workcell.{kind}").load()
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{SINGULAR[kind]} {name!r} ({plugin.source}) cannot be loaded: {type(error).__name__}: {error}"
        ) from error


def find(kind: Kind, name: str) -> Plugin:
    """A plug-in by its name.

    Raises:
        InputError: There is none; the message has the names there are.
    """
    there = known(kind)
    if name in there:
        return there[name]
    raise InputError(
        f"unknown {SINGULAR[kind]} {name!r}; known here: {', '.join(sorted(there)) or 'none'}"
        + did_you_mean(name, there)
    )


def make(
    kind: Kind, name: str, setup: Callable[[Any], object], given: Mapping[str, Any] | None = None
) -> Any:
    """An instance of a plug-in, made as every plug-in is: called once with its set-up.

    Args:
        kind, name: Which plug-in.
        setup: Gives the set-up for the validated options (None for a plug-in without options).
        given: The options' table of the scenario.

    Raises:
        InputError: There is no such plug-in, it does not take the options, or making it raised; the
            message names it.
    """
    chosen = setup(options(kind, name, given or {}))
    try:
        return load(kind, name)(chosen)
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{SINGULAR[kind]} {name!r} cannot be made: {type(error).__name__}: {error}"
        ) from error


def options(kind: Kind, name: str, given: Mapping[str, Any]) -> Any:
    """Options of a plug-in, validated by the model that it brings as its attribute `Options` (pydantic).

    Args:
        kind, name: Which plug-in.
        given: The table of the scenario.

    Returns:
        The model's instance; None for a plug-in without options.

    Raises:
        InputError: A key is unknown or a value is not allowed.
    """
    model = getattr(load(kind, name), "Options", None)
    if model is None:
        if given:
            raise InputError(
                f"{SINGULAR[kind]}.{name}: takes no options; given {', '.join(sorted(given))}"
            )
        return None
    try:
        return model(**given)
    except ValidationError as error:
        raise InputError(
            [f"{SINGULAR[kind]}.{name}.{_told(fault, model)}" for fault in error.errors()]
        ) from error
    except Exception as error:  # code of the plug-in's own, such as a validator
        raise InputError(
            f"{SINGULAR[kind]}.{name}: its options cannot be judged: {type(error).__name__}: {error}"
        ) from error


def _told(fault: Any, model: Any) -> str:
    """One validation error of a plug-in's options: key and what is allowed."""
    key = ".".join(map(str, fault["loc"]))
    if fault["type"] == "extra_forbidden" and len(fault["loc"]) == 1:
        allowed = sorted(model.model_fields)
        return f"{key}: unknown key {key!r}; allowed here: {', '.join(allowed) or 'none'}{did_you_mean(key, allowed)}"
    return f"{key}: {fault['msg']}"


def use_files(paths: Iterable[Path | str]) -> None:
    """Take plug-in files into this process and the processes it starts.

    Raises:
        InputError: A file is missing, cannot be run, or sets none of the dictionaries.
    """
    for path in paths:
        file = Path(path).resolve()
        if not file.is_file():
            raise InputError(f"--plugin {path}: no such file")
        if str(file) not in files():
            os.environ[FILES_VARIABLE] = os.pathsep.join([*files(), str(file)])
        _file(str(file))


def files() -> list[str]:
    """The plug-in files in use."""
    return [file for file in os.environ.get(FILES_VARIABLE, "").split(os.pathsep) if file]


def versions(used: Iterable[tuple[Kind, str]]) -> dict[str, str]:
    """Versions of the plug-ins that a scenario uses, built-in ones apart: for the trace.

    Args:
        used: Kinds and names.
    """
    found = [find(kind, name) for kind, name in used]
    return {
        f"{SINGULAR[plugin.kind]} {plugin.name}": f"{Path(plugin.source).name} {plugin.version}"
        for plugin in found
        if plugin.source != "built in"
    }


def _installed(kind: Kind) -> list[Plugin]:
    plugins = []
    for point in entry_points(group=f"workcell.{kind}"):
        distribution = point.dist
        source = "an installed package" if distribution is None else distribution.name
        version = "" if distribution is None else distribution.version
        plugins.append(Plugin(kind, point.name, source, version, point.value))
    return plugins


def _of_files(kind: Kind) -> list[Plugin]:
    return [
        Plugin(kind, name, file, hashlib.sha256(Path(file).read_bytes()).hexdigest()[:12], file)
        for file in files()
        for name in _file(file)[kind]
    ]


@cache
def _file(path: str) -> dict[str, dict[str, Any]]:
    """Run a plug-in file once and take its dictionaries."""
    name = f"workcell_plugin_{hashlib.sha256(path.encode()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError(f"--plugin {path}: not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(f"--plugin {path}: {type(error).__name__}: {error}") from error
    found = {kind: getattr(module, kind.upper(), {}) for kind in KINDS}
    if not any(found.values()):
        raise InputError(
            f"--plugin {path}: sets none of {', '.join(kind.upper() for kind in KINDS)}; each is a dictionary from name to class"
        )
    return found
