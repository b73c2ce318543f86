"""Scenario file -> frozen, validated `Scenario`.

A scenario is one TOML file: the cell (arms, obstacles), who drives each arm, the controller's
parameters, and the bounds that make the run a test (`[expect]`). Everything that can be judged
without MuJoCo is judged here, all faults at once; what needs the geometry is judged when the cell
is built. Units are in the key names; unknown keys, NaN and infinity are refused.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    model_validator,
)

from workcell import assets
from workcell.errors import InputError

UNIT_QUATERNION_TOLERANCE = 1e-3
"""How far the norm of a quaternion in a file may be off 1 (rounded to three digits); it is then normalised."""


def _unit(wxyz: tuple[float, ...]) -> tuple[float, ...]:
    norm = math.sqrt(sum(x * x for x in wxyz))
    if abs(norm - 1.0) > UNIT_QUATERNION_TOLERANCE:
        raise ValueError(
            f"a unit quaternion is needed (w, x, y, z; norm 1 within {UNIT_QUATERNION_TOLERANCE}), its norm is {norm:.6g}"
        )
    return tuple(x / norm for x in wxyz)


Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Probability = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]
Quaternion = Annotated[tuple[Finite, Finite, Finite, Finite], AfterValidator(_unit)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
Entry = Literal["left", "right", "above"]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=False)


class Simulation(_Table):
    """How the plant is stepped."""

    plant: Literal["dynamic", "kinematic"] = "dynamic"
    period_s: Annotated[float, Field(gt=0, le=0.02, allow_inf_nan=False)] = 0.002
    duration_s: Positive = 30.0
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    position_noise_rad: NonNegative = 0.0
    velocity_noise_rad_s: NonNegative = 0.0
    latency_ticks: Annotated[int, Field(ge=0, le=1000)] = 0
    dropped_fraction: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.0


Criterion = Literal["artc", "artc_approaching", "armd", "none"]


class Control(_Table):
    """Parameters of the controller; docs/scenario.md gives the reason for each default."""

    t_min_s: Positive = 1.0
    d_min_m: Positive = 0.01
    standoff_m: NonNegative = 0.0
    criterion: Criterion = "artc"
    order: Literal[1, 2] = 1
    variant: Literal["relative", "static"] = "relative"
    criterion_gain: NonNegative = 8.0
    task_gain_per_s: Positive = 10.0
    rise_time_s: Positive = 0.25
    reaction_s: NonNegative = 0.004
    catch_up_m_s: Positive = 0.15
    slow_down: Literal["ttc", "distance"] = "ttc"
    slow_distance_m: Positive = 0.15
    yields: bool = True
    resolves_impasse: bool = True
    entry: Entry | Literal[""] = ""


class Hold(_Table):
    """The arm keeps the tool pose it starts with."""

    kind: Literal["hold"]


class Waypoint(_Table):
    """A tool pose in the world; without `wxyz` the orientation of the waypoint before is kept."""

    position_m: Vector3
    wxyz: Quaternion | None = None


class Waypoints(_Table):
    """The tool follows a smooth path through waypoints, starting where it is; then, `repeat` times, back and forth along them."""

    kind: Literal["waypoints"]
    waypoints: Annotated[tuple[Waypoint, ...], Field(min_length=1)]
    speed_m_s: Positive = 0.15
    acceleration_m_s2: Positive = 0.5
    start_s: NonNegative = 0.0
    repeat: Annotated[int, Field(ge=0)] = 0
    pause_s: NonNegative = 0.0


class _Followed(_Table):
    """An input that may leap: caps on the target that follows it, and what counts as a leap."""

    max_speed_m_s: Positive = 0.5
    max_acceleration_m_s2: Positive = 2.0
    max_turn_rad_s: Positive = 1.0
    max_turn_rad_s2: Positive = 4.0
    jump_m: Positive = 0.05
    jump_rad: Positive = 0.35


class Recording(_Followed):
    """The tool follows a recorded stream of poses; docs/teleop.md has the format and the rules."""

    kind: Literal["recording"]
    file: str
    start_s: NonNegative = 0.0
    gap_s: Positive = 0.25


class Human(_Table):
    """A simulated person who works at sites; positions are in the world."""

    kind: Literal["human"]
    sites: Annotated[tuple[Waypoint, ...], Field(min_length=1)]
    speed_m_s: Positive = 0.2
    acceleration_m_s2: Positive = 0.5
    pause_s: tuple[Positive, Positive] = (0.3, 2.0)
    stop_probability: Probability = 0.3
    withdraw_probability: Probability = 0.1
    withdraw_m: Vector3 = (0.0, 0.0, 0.10)
    withdraw_speed_m_s: Positive = 0.4
    withdraw_acceleration_m_s2: Positive = 1.5
    elbow_probability: Probability = 0.1
    elbow_shift_m: Positive = 0.05
    tremor_m: NonNegative = 6e-5
    start_s: NonNegative = 0.5

    @model_validator(mode="after")
    def _pause_has_an_order(self) -> Human:
        if self.pause_s[0] > self.pause_s[1]:
            raise ValueError("pause_s is the shortest and the longest pause, in this order")
        return self


class Live(_Followed):
    """A person, through `workcell teleop`; times are those after which a fault is named."""

    kind: Literal["live"]
    stale_s: Positive = 0.1
    late_s: Positive = 0.1
    frozen_s: NonNegative = 0.0
    jump_confirm_s: NonNegative = 0.1


Operator = Annotated[Hold | Waypoints | Recording | Human | Live, Field(discriminator="kind")]


class _Motion(_Table):
    """What every job with a path has; the acceleration bounds its start and its end."""

    speed_m_s: Positive = 0.15
    acceleration_m_s2: Positive = 0.5


class Move(_Motion):
    """Move the tool along waypoints."""

    kind: Literal["move"]
    waypoints: Annotated[tuple[Waypoint, ...], Field(min_length=1)]
    free_rotation: bool = False


class Meet(_Motion):
    """Approach another arm's tool until the two tools are d_min apart, then dwell."""

    kind: Literal["meet"]
    arm: Name
    dwell_s: NonNegative = 0.5


class Fetch(_Motion):
    """Take an instrument from where it lies, from above."""

    kind: Literal["fetch"]
    instrument: Name
    dwell_s: NonNegative = 0.5


class Present(_Motion):
    """Bring the tool, or the instrument it holds, before another arm's tool, from a side seen from that arm's base."""

    kind: Literal["present"]
    arm: Name
    entry: Entry = "left"
    distance_m: Positive = 0.15
    free_rotation: bool = False


class Exchange(_Motion):
    """Hand an instrument to another arm's tool, or take it from there."""

    kind: Literal["exchange"]
    arm: Name
    instrument: Name
    direction: Literal["give", "take"]
    dwell_s: NonNegative = 0.5


class Put(_Motion):
    """Bring an instrument back to where it lay at the start, free end down, and let go of it."""

    kind: Literal["put"]
    instrument: Name


class Wait(_Table):
    """Stand still."""

    kind: Literal["wait"]
    duration_s: Positive


class Retreat(_Motion):
    """Go back along the path travelled since the start of the sequence."""

    kind: Literal["retreat"]
    free_rotation: bool = False


Job = Annotated[
    Move | Meet | Fetch | Present | Exchange | Put | Wait | Retreat, Field(discriminator="kind")
]


class Arm(_Table):
    """One arm of the cell."""

    name: Name
    model: str
    base_position_m: Vector3 = (0.0, 0.0, 0.0)
    base_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    home_rad: Annotated[tuple[Finite, ...], Field(min_length=1)]
    tool_site: str = "tool"
    elbow_site: str | None = None
    priority: Annotated[int, Field(ge=0)] = 0
    velocity_limit_rad_s: tuple[Positive, ...] | None = None
    acceleration_limit_rad_s2: tuple[Positive, ...] | None = None
    operator: Operator | None = None
    job: tuple[Job, ...] = ()
    job_repeat: Annotated[int, Field(ge=1)] = 1

    @model_validator(mode="after")
    def _driven_by_one(self) -> Arm:
        if (self.operator is None) == (not self.job):
            raise ValueError(
                "an arm is driven by either an operator or a sequence of jobs, exactly one of the two"
            )
        for key in ("velocity_limit_rad_s", "acceleration_limit_rad_s2"):
            limits = getattr(self, key)
            if limits is not None and len(limits) != len(self.home_rad):
                raise ValueError(
                    f"{key} has {len(limits)} entries, home_rad has {len(self.home_rad)}: one a joint is needed"
                )
        return self


class Obstacle(_Table):
    """A static primitive. `size_m` is MuJoCo's: box half extents; sphere radius; capsule and cylinder radius, half length."""

    name: Name
    shape: Literal["box", "sphere", "capsule", "cylinder"]
    size_m: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=3)]
    position_m: Vector3
    wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    rgba: tuple[NonNegative, NonNegative, NonNegative, NonNegative] = (0.75, 0.77, 0.8, 1.0)

    @model_validator(mode="after")
    def _size_fits_shape(self) -> Obstacle:
        wanted = {"box": 3, "sphere": 1, "capsule": 2, "cylinder": 2}[self.shape]
        if len(self.size_m) != wanted:
            raise ValueError(f"size_m has {len(self.size_m)} entries, a {self.shape} has {wanted}")
        return self


class Instrument(_Table):
    """A rod that arms can hold: a capsule along its own z axis. It lies where it is placed, or an arm holds it from the start."""

    name: Name
    radius_m: Positive = 0.008
    half_length_m: Positive = 0.07
    mass_kg: Positive = 0.1
    position_m: Vector3 | None = None
    wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    held_by: Name | None = None
    rests_on: tuple[Name, ...] = ()
    rgba: tuple[NonNegative, NonNegative, NonNegative, NonNegative] = (0.85, 0.65, 0.2, 1.0)

    @model_validator(mode="after")
    def _is_somewhere(self) -> Instrument:
        if (self.position_m is None) == (self.held_by is None):
            raise ValueError("an instrument either lies at position_m or is held_by an arm")
        return self


class Bound(_Table):
    """What a metric of the summary must be: an exact value, or a range."""

    min: Finite | None = None
    max: Finite | None = None
    equals: bool | int | str | None = None

    @model_validator(mode="after")
    def _says_something(self) -> Bound:
        if self.min is None and self.max is None and self.equals is None:
            raise ValueError("a bound needs min, max or equals")
        return self


class Change(_Table):
    """Parameters of `[control]` that change while the scenario runs, as a person changes them in `workcell teleop`."""

    time_s: NonNegative
    t_min_s: Positive | None = None
    criterion: Criterion | None = None
    entry: Entry | None = None

    @model_validator(mode="after")
    def _changes_something(self) -> Change:
        if not self.settings:
            raise ValueError("a change needs t_min_s, criterion or entry")
        return self

    @property
    def settings(self) -> dict[str, Any]:
        """The keys of `[control]` it sets."""
        return self.model_dump(exclude={"time_s"}, exclude_none=True)


def _as_bound(value: Any) -> Any:
    return {"equals": value} if isinstance(value, (bool, int, str)) else value


def _unique(items: tuple[Any, ...], what: str) -> None:
    names = [item.name for item in items]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise ValueError(f"{what} names must be unique, {', '.join(doubled)} occurs more than once")


class Check(_Table):
    """The final check in its own process; docs/final_check.md says what is lost without it."""

    enabled: bool = True
    d_min_m: Positive | None = None
    every_ticks: Annotated[int, Field(ge=1)] = 5
    stops_priority_arms: bool = False


class Sabotage(_Table):
    """Faults put into the controller on purpose, so that tests can see the final check stop it."""

    factor_multiplier: Positive = 1.0


class Variation(_Table):
    """How a sweep draws one key: exactly one of a range, a normal distribution, choices, or a spread
    around the value in the file (entry by entry for a list)."""

    min: float | int | None = None
    max: float | int | None = None
    log: bool = False
    mean: Finite | None = None
    sd: Positive | None = None
    choices: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None
    plus_minus: Positive | None = None

    @model_validator(mode="after")
    def _is_one_of_four(self) -> Variation:
        normal = self.mean is not None and self.sd is not None
        ranged = self.min is not None and self.max is not None and self.mean is None
        asked = [ranged, normal, self.choices is not None, self.plus_minus is not None]
        if sum(asked) != 1 or (self.mean is None) != (self.sd is None):
            raise ValueError(
                "allowed is exactly one of: min and max (log = true for a logarithmic range); "
                "mean and sd (with min, max to cut it off); choices; plus_minus"
            )
        if (self.min is None) != (self.max is None) or (
            not (ranged or normal) and self.min is not None
        ):
            raise ValueError("min and max come together, as a range or as the ends of a normal")
        if self.min is not None and self.max is not None:
            if not (math.isfinite(self.min) and math.isfinite(self.max) and self.min < self.max):
                raise ValueError("min must be below max, both finite")
            if self.log and self.min <= 0:
                raise ValueError("a logarithmic range needs min above 0")
        if self.log and not ranged:
            raise ValueError("log goes with a range, min and max")
        return self


def _known(name: str | None, allowed: list[str], where: str, what: str) -> None:
    if name is not None and name not in allowed:
        raise ValueError(
            f"{where}: {name!r} is not {what} of this scenario; allowed: {', '.join(allowed) or 'there is none'}"
        )


def _carry(
    holder: dict[str, str | None], arm: str, job: Fetch | Exchange | Put, where: str
) -> None:
    """Follow one arm's jobs with the instruments: nobody gives what it does not hold, or takes with a full hand."""
    giver: str | None
    taker: str | None
    if isinstance(job, Fetch):
        giver, taker = None, arm
    elif isinstance(job, Put):
        giver, taker = arm, None
    else:
        giver, taker = (arm, job.arm) if job.direction == "give" else (job.arm, arm)
    if holder[job.instrument] != giver:
        has = holder[job.instrument] or "nobody"
        raise ValueError(
            f"{where}: {job.instrument} must be held by {giver or 'nobody'} then, but {has} holds it"
        )
    if taker is not None and taker in holder.values():
        raise ValueError(f"{where}: {taker} holds an instrument already")
    holder[job.instrument] = taker


class Scenario(_Table):
    """A whole scenario file, resolved: every default is filled in."""

    name: Name
    description: str = ""
    simulation: Simulation = Simulation()
    control: Control = Control()
    check: Check = Check()
    sabotage: Sabotage = Sabotage()
    arm: Annotated[tuple[Arm, ...], Field(min_length=1)]
    obstacle: tuple[Obstacle, ...] = ()
    instrument: tuple[Instrument, ...] = ()
    change: tuple[Change, ...] = ()
    expect: dict[str, Annotated[Bound, BeforeValidator(_as_bound)]] = {}
    vary: dict[str, Variation] = {}
    _file: Path | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _fits_together(self) -> Scenario:
        _unique(self.arm, "arm")
        _unique(self.obstacle, "obstacle")
        _unique(self.instrument, "instrument")
        arms = [arm.name for arm in self.arm]
        for thing in (*self.obstacle, *self.instrument):
            if thing.name in arms:
                raise ValueError(
                    f"{thing.name} is the name of an arm and of an obstacle or instrument"
                )
        obstacles = [obstacle.name for obstacle in self.obstacle]
        holder: dict[str, str | None] = {}
        for item in self.instrument:
            _known(item.held_by, arms, f"instrument {item.name}: held_by", "an arm")
            for support in item.rests_on:
                _known(support, obstacles, f"instrument {item.name}: rests_on", "an obstacle")
            if item.held_by is not None and item.held_by in holder.values():
                raise ValueError(
                    f"instrument {item.name}: {item.held_by} holds another one already"
                )
            holder[item.name] = item.held_by
        for arm in self.arm:
            others = [name for name in arms if name != arm.name]
            for index, job in enumerate(arm.job * arm.job_repeat):
                where = f"arm {arm.name}: job {index % len(arm.job)} ({job.kind})"
                if isinstance(job, (Meet, Present, Exchange)):
                    _known(job.arm, others, f"{where}: arm", "another arm")
                if isinstance(job, (Fetch, Exchange, Put)):
                    _known(job.instrument, list(holder), f"{where}: instrument", "an instrument")
                    if isinstance(job, Put) and next(
                        item.position_m is None
                        for item in self.instrument
                        if item.name == job.instrument
                    ):
                        raise ValueError(
                            f"{where}: {job.instrument} has no place of its own (position_m)"
                        )
                    _carry(holder, arm.name, job, where)
        return self

    @property
    def file(self) -> str:
        """Where the scenario was read from, for messages; its name if from nowhere."""
        return self.name if self._file is None else str(self._file)

    @property
    def ticks(self) -> int:
        """Number of control ticks of a full run."""
        return round(self.simulation.duration_s / self.simulation.period_s)

    def to_toml(self) -> str:
        """The resolved scenario as TOML; reading it back gives the same content and digest."""
        return tomli_w.dumps(_without_none(self.model_dump(mode="json")))

    def digest(self) -> str:
        """SHA-256 over the resolved content that a run depends on, independent of layout and comments of the file."""
        resolved = self.model_dump(mode="json", exclude={"vary"})
        content = json.dumps(resolved, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(content.encode()).hexdigest()


def find(scenario: str) -> Path:
    """The file of a scenario given by shipped name or by path.

    Raises:
        InputError: neither a shipped name nor an existing file.
    """
    if assets.scenario_file(scenario).is_file():
        return assets.scenario_file(scenario)
    path = Path(scenario)
    if path.is_file():
        return path
    raise InputError(
        f"no such scenario: {scenario!r}; allowed: a path to a .toml file, or one of {', '.join(assets.scenario_names())}"
    )


def load(scenario: str | Path, overrides: tuple[str, ...] = ()) -> Scenario:
    """Read, override and validate a scenario.

    Args:
        scenario: Shipped name or path of a .toml file.
        overrides: `KEY=VALUE` with dotted keys of the file; an arm or obstacle is addressed by its
            name (`arm.nurse.priority=2`), VALUE is TOML or, failing that, a plain string.

    Raises:
        InputError: with every fault found, each naming key, value and what is allowed.
    """
    path = find(str(scenario))
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"not valid TOML: {error}", file=path) from error
    content.setdefault("name", path.stem)
    for override in overrides:
        _apply(content, override, path)
    _resolve_models(content, path.parent)
    return validate(content, path)


def validate(content: dict[str, Any], path: Path | None) -> Scenario:
    """The scenario of a parsed file.

    Args:
        content: What the file holds, paths of models resolved.
        path: Where it was read from, for messages.

    Raises:
        InputError: with every fault found, each naming key, value and what is allowed.
    """
    try:
        scenario = Scenario.model_validate(content)
    except ValidationError as error:
        raise InputError(
            [_fault(item, content) for item in _roots(error.errors())], file=path
        ) from error
    scenario._file = path
    return scenario


def _apply(content: dict[str, Any], override: str, path: Path) -> None:
    """Set one dotted key in the parsed file."""
    key, separator, text = override.partition("=")
    if not separator or not key:
        raise InputError(
            f"--set {override!r}: allowed is KEY=VALUE with a dotted key of the scenario file",
            file=path,
        )
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    node: Any = content
    *parents, last = key.split(".")
    for part in parents:
        node = _descend(node, part, key, path)
    if isinstance(node, list):
        raise InputError(
            f"--set {key}: {last!r} would replace one of several entries; name a key inside it",
            file=path,
        )
    if parents[-1:] == ["operator"] and last == "file":
        here = Path(str(value))
        # A file seen from the working folder is that one, any other is relative to the scenario.
        _become(node, "recording", file=str(here.resolve() if here.is_file() else here))
    elif parents[-1:] == ["operator"] and last == "kind":
        _become(node, str(value))
    else:
        node[last] = value


def _become(operator: dict[str, Any], kind: str, **settings: Any) -> None:
    """Turn a table into an operator of a kind; keys that kind does not have go with the old one."""
    table = _TAGGED.get(kind)
    kept = {key: x for key, x in operator.items() if table is None or key in table.model_fields}
    operator.clear()
    operator.update(kept | settings, kind=kind)


def _descend(node: Any, part: str, key: str, path: Path) -> Any:
    if isinstance(node, dict):
        node = node.setdefault(part, {})
        if isinstance(node, (dict, list)):
            return node
        raise InputError(f"--set {key}: {part!r} is a value, not a table", file=path)
    names = [str(item.get("name", index)) for index, item in enumerate(node)]
    if part in names:
        return node[names.index(part)]
    if part.isdecimal() and int(part) < len(node):
        return node[int(part)]
    raise InputError(f"--set {key}: no entry {part!r}; allowed: {', '.join(names)}", file=path)


def _resolve_models(content: dict[str, Any], folder: Path) -> None:
    """Make relative paths of arm files and recordings absolute; shipped names stay names."""
    arms = content.get("arm")
    for arm in arms if isinstance(arms, list) else []:
        model = arm.get("model") if isinstance(arm, dict) else None
        if isinstance(model, str) and model not in assets.model_names():
            arm["model"] = str((folder / model).resolve())
        operator = arm.get("operator") if isinstance(arm, dict) else None
        file = operator.get("file") if isinstance(operator, dict) else None
        if isinstance(operator, dict) and isinstance(file, str):
            operator["file"] = str((folder / file).resolve())


def _roots(items: list[Any]) -> list[Any]:
    """Leave out 'too few entries' where entries are missing only because they are at fault themselves."""
    locations = [item["loc"] for item in items]
    return [
        item
        for item in items
        if item["type"] != "too_short"
        or not any(
            len(loc) > len(item["loc"]) and loc[: len(item["loc"])] == item["loc"]
            for loc in locations
        )
    ]


def _fault(item: Any, content: dict[str, Any]) -> str:
    """One validation error in the words of the file: dotted key, value, what is allowed."""
    key: list[str] = []
    node: Any = content
    for part in item["loc"]:
        if isinstance(node, dict) and part in node:
            node = node[part]
            key.append(str(part))
        elif isinstance(node, (list, tuple)) and isinstance(part, int) and part < len(node):
            node = node[part]
            key.append(str(node.get("name", part)) if isinstance(node, dict) else str(part))
        elif item["type"] == "missing":
            key.append(str(part))
    name = ".".join(key) or "scenario"
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "missing":
        return f"{name}: this key is missing and has no default"
    if item["type"] == "extra_forbidden":
        return f"{name} = {node!r}: unknown key; allowed here: {', '.join(_allowed(item['loc']))}"
    if isinstance(node, dict):
        return f"{name}: {message}"
    return f"{name} = {node!r}: {message}"


def _allowed(location: tuple[Any, ...]) -> list[str]:
    """The keys allowed in the table that holds the unknown key at `location`."""
    node: Any = Scenario
    for part in location[:-1]:
        if isinstance(part, int):
            continue
        node = _TAGGED.get(part) or _table_of(node, part)
    return sorted(node.model_fields)


def _table_of(table: Any, key: str) -> Any:
    """The model class behind a key, seen through tuples, unions and annotations."""
    return _first_table(table.model_fields[key].annotation) or table


def _first_table(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        found = _first_table(inner)
        if found:
            return found
    return None


_TAGGED = {
    "hold": Hold,
    "waypoints": Waypoints,
    "recording": Recording,
    "human": Human,
    "live": Live,
    "move": Move,
    "meet": Meet,
    "fetch": Fetch,
    "present": Present,
    "exchange": Exchange,
    "put": Put,
    "wait": Wait,
    "retreat": Retreat,
}


def _without_none(value: Any) -> Any:
    """TOML has no null: a key that is None is left out."""
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [_without_none(v) for v in value]
    return value
