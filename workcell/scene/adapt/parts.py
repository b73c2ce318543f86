"""Several arms in one file -> one adapted arm a part, in the frame of the whole robot.

In: an arm file, and the tool of each part. Joints on the way to more than one tool (a torso's) are locked. The first
part carries all that belongs to no other: torso, head, pedestal. Out: the parts, which stand at the same base pose,
and the pairs of links of different parts that cannot be held apart, each with its reason.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import mujoco
import numpy as np
from lxml import etree

from workcell.errors import InputError
from workcell.scene.adapt import choose, home
from workcell.scene.adapt.adapt import Adapted, Wishes, adapt
from workcell.scene.adapt.capsules import Capsule
from workcell.scene.adapt.source import read
from workcell.scene.arm_file import ArmFile, plain
from workcell.scene.pairs import NEIGHBOUR_JOINTS

Pair = tuple[str, str]


@dataclass(frozen=True)
class Near:
    """Links of two parts that the controller cannot hold apart."""

    one: str
    """`part/body`."""
    other: str
    reason: str
    housings_apart: bool
    """Whether their housings never come near in the sampled poses: the final check can hold them apart."""


@dataclass(frozen=True)
class Robot:
    """The parts of one file."""

    name: str
    parts: dict[str, Adapted]
    """By the name of the part."""
    ignored: tuple[Near, ...]
    said: tuple[str, ...]


def adapt_parts(path: Path, tools: Mapping[str, str], wishes: Wishes) -> Robot:
    """Adapt several arms of one file.

    Args:
        path: The arm file.
        tools: Site or body that is the tool, by the name of the part.
        wishes: For all of them: name of the robot, tool offset, locked joints.

    Raises:
        InputError: the file does not compile, a name is unknown, or one part lies on the way to another.
    """
    file = read(path)
    name = wishes.name or choose.name_of(path)
    ways = _ways(file, tools)
    roots = _roots(file, ways)
    shared = _shared(file, ways)
    locked = dict(wishes.locked)
    said = []
    if shared:
        first = choose.chain(file, next(iter(tools.values())), None, {})
        qpos, _ = choose.start(file, first, wishes.locked)
        for joint in shared:
            value = float(qpos[file.model.jnt_qposadr[joint]])
            locked.setdefault(file.joints[joint], value)
        names = ", ".join(file.joints[joint] for joint in shared)
        said.append(f"{names}: would move more than one part, thus locked")
    parts: dict[str, Adapted] = {}
    for number, (part, tool) in enumerate(tools.items()):
        own = replace(wishes, name=f"{name}_{part}", tool=tool, locked=locked)
        if number == 0:
            own = replace(own, without=tuple(file.bodies[b] for p, b in roots.items() if p != part))
        else:
            own = replace(own, only=file.bodies[roots[part]])
        parts[part] = adapt(path, own)
    said.append(f"what belongs to no other part is carried by {next(iter(tools))}")
    return _settled(name, parts, said)


def _ways(file: ArmFile, tools: Mapping[str, str]) -> dict[str, list[int]]:
    """From each part's tool up to the world."""
    ways, faults = {}, []
    for part, tool in tools.items():
        if plain(tool) in file.sites:
            body = int(file.model.site_bodyid[file.sites.index(plain(tool))])
        elif plain(tool) in file.bodies:
            body = file.bodies.index(plain(tool))
        else:
            known = ", ".join((*file.sites, *file.bodies[1:]))
            faults.append(f"--part {part}={tool}: no such site or body; allowed: {known}")
            continue
        ways[part] = choose.way_up(file.model, body)
    if faults:
        raise InputError(faults, file=file.path)
    return ways


def _roots(file: ArmFile, ways: Mapping[str, list[int]]) -> dict[str, int]:
    """The highest body of each part that carries no other part's tool."""
    roots = {}
    for part, way in ways.items():
        others = {body for other, bodies in ways.items() if other != part for body in bodies}
        own = [body for body in way if body not in others]
        if not own:
            raise InputError(
                f"--part {part}: its tool carries another part's; allowed are tools at the ends of different arms",
                file=file.path,
            )
        roots[part] = own[-1]
    return roots


def _shared(file: ArmFile, ways: Mapping[str, list[int]]) -> list[int]:
    """Joints on the way to more than one tool."""
    counts = np.zeros(file.model.nbody, dtype=int)
    for way in ways.values():
        counts[way] += 1
    return [j for j in range(file.model.njnt) if counts[file.model.jnt_bodyid[j]] > 1]


class _Pose:
    """A part's model with the capsules of its links."""

    def __init__(self, part: Adapted):
        self.xml = part.xml
        self.model = mujoco.MjModel.from_xml_string(part.xml)
        self.data = mujoco.MjData(self.model)
        self.geoms = np.flatnonzero(self.model.geom_group == 4).tolist()
        self.bodies = [self.model.body(self.model.geom_bodyid[g]).name for g in self.geoms]
        self.joints = [self._joints(int(self.model.geom_bodyid[g])) for g in self.geoms]

    def _joints(self, body: int) -> int:
        return sum(int(self.model.body_jntnum[b]) for b in choose.way_up(self.model, body))

    def at(self, q: np.ndarray) -> list[Capsule]:
        """Its capsules in a pose, in the robot's frame."""
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        return [home.capsule_at(self.model, self.data, g) for g in self.geoms]


def _settled(name: str, parts: dict[str, Adapted], said: list[str]) -> Robot:
    """What cannot be held apart, and homes in which the parts are clear of one another."""
    poses = {part: _Pose(adapted) for part, adapted in parts.items()}
    ignored: dict[frozenset[str], Near] = {}
    for one, other in combinations(parts, 2):
        for near in _touching((one, poses[one]), (other, poses[other])):
            ignored[frozenset((near.one, near.other))] = near
    settled: dict[str, Adapted] = {}
    for part, adapted in parts.items():
        before = [
            (f"{other}/{body}", capsule)
            for other in settled
            for body, capsule in zip(
                poses[other].bodies, poses[other].at(np.array(settled[other].home_rad)), strict=True
            )
        ]
        own = [f"{part}/{body}" for body in poses[part].bodies]

        def beside(data: mujoco.MjData, own=own, before=before, pose=poses[part]) -> float:
            capsules = [home.capsule_at(pose.model, data, g) for g in pose.geoms]
            return min(
                (
                    home.gap(mine, theirs)
                    for body, mine in zip(own, capsules, strict=True)
                    for there, theirs in before
                    if frozenset((body, there)) not in ignored
                ),
                default=np.inf,
            )

        pose = poses[part]
        pose.at(np.array(adapted.home_rad))
        if beside(pose.data) <= home.CLEAR_M:
            excluded = _excluded(pose.model)
            found = home.choose(pose.model, excluded, None, beside)
            home_rad = tuple(round(float(q), 4) for q in found.q)
            adapted = replace(
                adapted, home_rad=home_rad, xml=_with_home(adapted.xml, home_rad),
                guessed=(*adapted.guessed, f"{part}: its own home is too near another part, thus {found.guessed[-1]}"),
            )  # fmt: skip
        settled[part] = adapted
    return Robot(name, settled, tuple(ignored.values()), tuple(said))


def _touching(one: tuple[str, _Pose], other: tuple[str, _Pose]) -> Iterator[Near]:
    """Links of two parts that are near by how the robot is built."""
    (first, p), (second, r) = one, other
    counts: dict[Pair, int] = {}
    joints: dict[Pair, int] = {}
    samples = zip(home.poses(p.model), home.poses(r.model)[::-1], strict=True)
    for q_one, q_other in samples:
        near: set[Pair] = set()
        theirs = r.at(q_other)
        for i, mine in enumerate(p.at(q_one)):
            for k, capsule in enumerate(theirs):
                if home.gap(mine, capsule) < home.NEAR_M:
                    pair = p.bodies[i], r.bodies[k]
                    joints[pair] = p.joints[i] + r.joints[k]
                    near.add(pair)
        for pair in near:
            counts[pair] = counts.get(pair, 0) + 1
    for (a, b), count in sorted(counts.items()):
        if not joints[a, b]:
            continue
        share = count / home.SAMPLES
        if joints[a, b] <= NEIGHBOUR_JOINTS:
            reason = f"at most {NEIGHBOUR_JOINTS} joints apart in the robot, near in {100 * share:.0f} % of {home.SAMPLES} poses"
        elif share >= home.BY_CONSTRUCTION:
            reason = f"touch in {100 * share:.0f} % of {home.SAMPLES} poses, thus by construction"
        else:
            continue
        yield Near(f"{first}/{a}", f"{second}/{b}", reason, _housings_apart(p, r, a, b))


def _housings_apart(p: _Pose, r: _Pose, one: str, other: str) -> bool:
    """Whether two links' housings keep apart in all sampled poses."""
    spec = mujoco.MjSpec()
    for prefix, pose in (("p/", p), ("r/", r)):
        spec.attach(
            mujoco.MjSpec.from_string(pose.xml), prefix=prefix, frame=spec.worldbody.add_frame()
        )
    model = spec.compile()
    data = mujoco.MjData(model)

    def housing(body: str) -> list[int]:
        number = model.body(body).id
        return [
            g
            for g in range(model.ngeom)
            if model.geom_bodyid[g] == number and model.geom_group[g] != 4
        ]

    pairs = [(g, h) for g in housing(f"p/{one}") for h in housing(f"r/{other}")]
    for q in zip(home.poses(p.model), home.poses(r.model)[::-1], strict=True):
        data.qpos[:] = np.concatenate(q)
        mujoco.mj_kinematics(model, data)
        if any(
            mujoco.mj_geomDistance(model, data, g, h, 1.0, None) < home.NEAR_M for g, h in pairs
        ):
            return False
    return True


def _excluded(model: mujoco.MjModel) -> home.Pairs:
    """The exclusions of an adapted arm, by body names."""
    numbers = [(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature]
    return tuple((model.body(i).name, model.body(j).name) for i, j in numbers)


def _with_home(xml: str, home_rad: tuple[float, ...]) -> str:
    """The text with another home."""
    root = etree.fromstring(xml)
    key = root.find("keyframe/key")
    assert key is not None
    key.set("qpos", " ".join(repr(q) for q in home_rad))
    return etree.tostring(root, encoding="unicode") + "\n"
