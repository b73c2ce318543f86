"""An arm of a scenario, ready to be attached: which of its joints are driven, and where the rest stand.

Driven are the joints on the way from the base to the tool, unless the scenario locks them. The rest
do not move the tool: fingers, or a second arm in the same file. Self-motion must never move them. They
are left out, and their bodies stand where their joints are held.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workcell import assets
from workcell.errors import InputError
from workcell.scenario import Arm, Scenario
from workcell.scene import arm_file
from workcell.scene.arm_file import HINGE, KEPT, SLIDE, ArmFile, plain
from workcell.scene.coverage import Bare, bare_housing, sampled_links, watched_geoms
from workcell.scene.normal_form import NormalForm, normal_form, rigid_links

SAID_M = 5e-4
"""Housing that reaches out of its capsules by less than this is not worth a line."""


@dataclass(frozen=True, eq=False)
class ArmPart:
    """An arm of a cell before it is attached."""

    name: str
    file: ArmFile
    """Its file, compiled alone."""
    form: NormalForm
    """What is attached."""
    home: NDArray[np.float64]
    """(nq,) home configuration of the file's model, driven or not."""
    watched: tuple[str, ...]
    """Names of its watched geoms."""
    bare: tuple[Bare, ...]
    """How far the housing of each link reaches out of what is watched."""
    asked: int
    """Number of joints that the scenario's `home_rad` speaks of: all of the file, or the driven ones."""

    @property
    def driven(self) -> tuple[int, ...]:
        """Numbers of its driven joints among those of the file."""
        return self.form.driven

    @property
    def home_rad(self) -> NDArray[np.float64]:
        """(n,) home of the driven joints."""
        return self.home[self.file.model.jnt_qposadr[list(self.driven)]]

    def of_driven(self, values: tuple[float, ...]) -> NDArray[np.float64]:
        """Of one value a joint, as the scenario counts joints, those of the driven ones."""
        if len(values) == len(self.file.joints) != len(self.driven):
            return np.array(values)[list(self.driven)]
        return np.array(values)

    @property
    def digest(self) -> str:
        """Equal for arms of equal files that hold their undriven joints alike."""
        return f"{self.file.digest} {hashlib.sha256(self.form.xml.encode()).hexdigest()}"

    @property
    def notes(self) -> Iterator[str]:
        """What was not taken from the file, which joints are held, and which housing is bare."""
        held = [
            f"{name} = {self.home[self.file.model.jnt_qposadr[number]]:.6g}"
            for number, name in enumerate(self.file.joints)
            if number not in self.driven
        ]
        if held:
            yield f"arm.{self.name}: held where they are, since they do not move the tool or are locked: {', '.join(held)}"
        for note in (*self.file.neutralised, *self.form.left_out):
            yield f"arm.{self.name}: {self.file.path.name}: {note}"
        for link in self.bare:
            if link.outside_m > SAID_M:
                yield (
                    f"arm.{self.name}: {link.link}: housing reaches {1e3 * link.outside_m:.1f} mm out of what is watched "
                    f"({link.geom}{'' if link.moves else '; it stands still'})"
                )


def arm_part(arm: Arm, scenario: Scenario) -> ArmPart:
    """Make an arm of the scenario ready to be attached.

    Raises:
        InputError: the file is missing, does not compile or has what no cell can carry; the tool
            site, a locked joint or the keyframe does not exist; `home_rad` has a wrong length; housing
            is bare. All reasons at once.
    """
    key = f"arm.{arm.name}"
    path = _path_of(arm.model, key)
    if not path.is_file():
        raise InputError(
            f"{key}.model = {arm.model!r}: no such arm file; allowed: a path to an MJCF file, or one of {', '.join(assets.model_names())}"
        )
    where = f"{key}.model = {str(path)!r}"
    try:
        file = arm_file.read(path)
    except InputError as error:
        raise InputError([f"{where}: {fault}" for fault in error.faults]) from error
    faults = list(_faults_of_file(file, arm, where))
    if faults:
        raise InputError(faults)
    driven = driven_joints(file, file.sites.index(plain(arm.tool_site)), arm.locked)
    home = _home(file, arm, driven)
    try:
        form, watched, bare = _prepared(file, tuple(home.tolist()), driven)
    except InputError as error:
        raise InputError([f"{where}: {fault}" for fault in error.faults]) from error
    faults = list(_faults_of_bare(bare, arm, where, scenario.control.d_min_m))
    if faults:
        raise InputError(faults)
    asked = len(driven) if isinstance(arm.home_rad, str) else len(arm.home_rad)
    return ArmPart(arm.name, file, form, home, watched, bare, asked)


def _path_of(model: str, key: str) -> Path:
    """The arm file of a shipped name, a library's arm or a path."""
    if model in assets.model_names():
        return assets.model_file(model)
    if not model.startswith(assets.LIBRARY_PREFIXES):
        return Path(model)
    # The importer takes a second to import, which scenes of shipped arms need not wait for.
    from workcell.scene.adapt.library import adapted_file

    try:
        return adapted_file(model)
    except InputError as error:
        raise InputError([f"{key}.model = {fault}" for fault in error.faults]) from error


def driven_joints(file: ArmFile, site: int, locked: dict[str, float]) -> tuple[int, ...]:
    """Joints between a site and the world, in the order of the file, without the locked ones."""
    model, joints = file.model, []
    body = int(model.site_bodyid[site])
    while body:
        start = model.body_jntadr[body]
        joints += range(start, start + model.body_jntnum[body])
        body = int(model.body_parentid[body])
    names = {plain(name) for name in locked}
    return tuple(joint for joint in sorted(joints) if file.joints[joint] not in names)


@lru_cache(maxsize=KEPT)
def _prepared(
    file: ArmFile, home: tuple[float, ...], driven: tuple[int, ...]
) -> tuple[NormalForm, tuple[str, ...], tuple[Bare, ...]]:
    form = normal_form(file, np.array(home), driven)
    links = sampled_links(file.model, rigid_links(file.model, driven), np.array(home), driven)
    watched = watched_geoms(links)
    bare = bare_housing(links, watched, (file.bodies, file.geoms))
    return form, tuple(file.geoms[g] for g in watched), bare


def _faults_of_file(file: ArmFile, arm: Arm, where: str) -> Iterator[str]:
    for name, kind in zip(file.joints, file.kinds, strict=True):
        if kind not in (HINGE, SLIDE):
            yield f"{where}: joint {name!r} is of type {kind}; allowed are hinge and slide"
    if not file.joints:
        yield f"{where}: has no joints; an arm needs at least one hinge or slide joint"
    key = f"arm.{arm.name}"
    for site_key, site in (("tool_site", arm.tool_site), ("elbow_site", arm.elbow_site)):
        if site is not None and plain(site) not in file.sites:
            yield f"{key}.{site_key} = {site!r}: no such site in {file.path.name}; allowed: {', '.join(file.sites) or 'it has no sites'}"
    for name, value in arm.locked.items():
        if plain(name) not in file.joints:
            yield f"{key}.locked.{name}: no such joint in {file.path.name}; allowed: {', '.join(file.joints)}"
            continue
        joint = file.joints.index(plain(name))
        lower, upper = file.model.jnt_range[joint]
        if file.model.jnt_limited[joint] and not lower <= value <= upper:
            yield f"{key}.locked.{name} = {value:g}: the joint allows {lower:.4g} to {upper:.4g}"
    if file.joints:
        yield from _faults_of_home(file, arm)


def _faults_of_home(file: ArmFile, arm: Arm) -> Iterator[str]:
    known = plain(arm.tool_site) in file.sites
    driven = (
        driven_joints(file, file.sites.index(plain(arm.tool_site)), arm.locked)
        if known
        else tuple(range(len(file.joints)))
    )
    names = [file.joints[joint] for joint in driven]
    key = f"arm.{arm.name}"
    if not driven:
        yield f"{key}.tool_site = {arm.tool_site!r}: no joint that is not locked moves it; an arm needs one at least"
    if isinstance(arm.home_rad, str):
        keys = [file.model.key(k).name for k in range(file.model.nkey)]
        if arm.home_rad.removeprefix("key:") not in keys:
            yield f"{key}.home_rad = {arm.home_rad!r}: no such keyframe in {file.path.name}; allowed: {', '.join(f'key:{k}' for k in keys) or 'it has none'}"
    elif len(arm.home_rad) not in (len(file.joints), len(driven)):
        also = f", of which {len(driven)} move {arm.tool_site} ({', '.join(names)})"
        yield (
            f"{key}.home_rad: has {len(arm.home_rad)} entries, {file.path.name} has {len(file.joints)} joints ({', '.join(file.joints)})"
            + (also if len(driven) != len(file.joints) else "")
        )


def _home(file: ArmFile, arm: Arm, driven: tuple[int, ...]) -> NDArray[np.float64]:
    """(nq,) where all joints of the file start."""
    model = file.model
    home = model.qpos0.copy()
    for joint in np.flatnonzero(model.jnt_limited):
        address = model.jnt_qposadr[joint]
        home[address] = np.clip(home[address], *model.jnt_range[joint])
    if isinstance(arm.home_rad, str):
        home = model.key(arm.home_rad.removeprefix("key:")).qpos.copy()
    else:
        entries = driven if len(arm.home_rad) == len(driven) else range(model.njnt)
        home[model.jnt_qposadr[list(entries)]] = arm.home_rad
    for name, value in arm.locked.items():
        home[model.jnt_qposadr[file.joints.index(plain(name))]] = value
    return home


def _faults_of_bare(
    bare: tuple[Bare, ...], arm: Arm, where: str, allowed_m: float
) -> Iterator[str]:
    """Housing that could touch while what is watched is still d_min away from everything."""
    if arm.allow_bare_housing:
        return
    for link in bare:
        if link.moves and link.outside_m > allowed_m:
            how_far = (
                "with nothing watched"
                if np.isinf(link.outside_m)
                else (f"{1e3 * link.outside_m:.1f} mm out of what is watched")
            )
            yield (
                f"{where}: {link.link}: housing {link.geom} reaches {how_far}; allowed is control.d_min_m = {allowed_m:g} m. "
                f"Give the link capsules (group 4) that contain it, or set arm.{arm.name}.allow_bare_housing = true"
            )
