"""The tables of a scenario file: names, types, defaults and bounds of every key.

Operators and jobs have a file each. Units are in the key names. Unknown keys, NaN and infinity are
refused. docs/scenario.md says what each key means and why its default is what it is.
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import tomli_w
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    model_validator,
)

from workcell.scenario.checks import fits_together
from workcell.scenario.jobs import Job
from workcell.scenario.operators import Operator
from workcell.scenario.plugged import plugin_faults
from workcell.scenario.values import (
    MOST_ARMS,
    MOST_ENTRIES,
    MOST_JOBS,
    MOST_JOINTS,
    MOST_THINGS,
    SHORTEST_PERIOD_S,
    Acceleration,
    Description,
    Duration,
    DurationOrZero,
    Entry,
    FileName,
    Finite,
    JointPosition,
    Label,
    Length,
    LengthOrZero,
    Mass,
    Name,
    Noise,
    NonNegative,
    Positive,
    Quaternion,
    Shade,
    Speed,
    Table,
    ToolTask,
    Vector3,
    Whole,
    at_least,
)


class Simulation(Table):
    """How the plant is stepped."""

    plant: Literal["dynamic", "kinematic"] = "dynamic"
    period_s: Annotated[
        float, Field(gt=0, le=0.02, allow_inf_nan=False), at_least(SHORTEST_PERIOD_S)
    ] = 0.002
    duration_s: Duration = 30.0
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    position_noise_rad: Noise = 0.0
    velocity_noise_rad_s: Noise = 0.0
    latency_ticks: Annotated[int, Field(ge=0, le=1000)] = 0
    dropped_fraction: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.0


class Control(Table):
    """Parameters of the controller; docs/scenario.md gives the reason for each default."""

    t_min_s: Duration = 1.0
    d_min_m: Length = 0.01
    standoff_m: LengthOrZero = 0.0
    criterion: Label = "artc"
    order: Literal[1, 2] = 1
    variant: Literal["relative", "static"] = "relative"
    criterion_gain: NonNegative = 8.0
    task_gain_per_s: Positive = 10.0
    rise_time_s: Duration = 0.25
    reaction_s: DurationOrZero = 0.004
    catch_up_m_s: Speed = 0.15
    slow_down: Literal["ttc", "distance"] = "ttc"
    slow_distance_m: Length = 0.15
    strategy: Label = "ttc"
    yields: bool = True
    resolves_impasse: bool = True
    detour_m: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = 0.0
    entry: Entry | Literal[""] = ""
    gate: bool = True
    point_speed_m_s: Speed = 1.0


class Arm(Table):
    """One arm of the cell."""

    name: Name
    model: FileName
    base_position_m: Vector3 = (0.0, 0.0, 0.0)
    base_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    home_rad: Annotated[
        Annotated[
            tuple[JointPosition, ...], Field(min_length=1, max_length=MOST_JOINTS), Tag("joints")
        ]
        | Annotated[str, Field(pattern=r"^key:.+$", max_length=200), Tag("keyframe")],
        Discriminator(lambda value: "keyframe" if isinstance(value, str) else "joints"),
    ]
    locked: dict[Label, JointPosition] = Field(default_factory=dict, max_length=MOST_JOINTS)
    allow_bare_housing: bool = False
    tool_site: Label = "tool"
    elbow_site: Label | None = None
    task: ToolTask = "pose"
    self_motion: bool = True
    priority: Annotated[int, Field(ge=0, le=1000)] = 0
    velocity_limit_rad_s: tuple[Speed, ...] | None = None
    acceleration_limit_rad_s2: tuple[Acceleration, ...] | None = None
    strategy: Label | None = None
    criterion: Label | None = None
    operator: Operator | None = None
    job: Annotated[tuple[Job, ...], Field(max_length=MOST_JOBS)] = ()
    job_repeat: Annotated[int, Field(ge=1, le=MOST_JOBS)] = 1

    @model_validator(mode="after")
    def _driven_by_one(self) -> Arm:
        if (self.operator is None) == (not self.job):
            raise ValueError(
                "an arm is driven by either an operator or a sequence of jobs, exactly one of the two"
            )
        for key in ("velocity_limit_rad_s", "acceleration_limit_rad_s2"):
            limits = getattr(self, key)
            if isinstance(self.home_rad, str) or limits is None:
                continue
            if len(limits) != len(self.home_rad):
                raise ValueError(
                    f"{key} has {len(limits)} entries, home_rad has {len(self.home_rad)}: one a joint is needed"
                )
        return self


class Obstacle(Table):
    """A static primitive. `size_m` is MuJoCo's: box half extents; sphere radius; capsule and cylinder radius, half length."""

    name: Name
    shape: Literal["box", "sphere", "capsule", "cylinder"]
    size_m: Annotated[tuple[Length, ...], Field(min_length=1, max_length=3)]
    position_m: Vector3
    wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    rgba: tuple[Shade, Shade, Shade, Shade] = (0.75, 0.77, 0.8, 1.0)

    @model_validator(mode="after")
    def _size_fits_shape(self) -> Obstacle:
        wanted = {"box": 3, "sphere": 1, "capsule": 2, "cylinder": 2}[self.shape]
        if len(self.size_m) != wanted:
            raise ValueError(f"size_m has {len(self.size_m)} entries, a {self.shape} has {wanted}")
        return self


class Instrument(Table):
    """A rod that arms can hold: a capsule along its own z axis. It lies where it is placed, or an arm holds it from the start."""

    name: Name
    radius_m: Length = 0.008
    half_length_m: Length = 0.07
    mass_kg: Mass = 0.1
    position_m: Vector3 | None = None
    wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    held_by: Name | None = None
    rests_on: Annotated[tuple[Name, ...], Field(max_length=MOST_THINGS)] = ()
    rgba: tuple[Shade, Shade, Shade, Shade] = (0.85, 0.65, 0.2, 1.0)

    @model_validator(mode="after")
    def _is_somewhere(self) -> Instrument:
        if (self.position_m is None) == (self.held_by is None):
            raise ValueError("an instrument either lies at position_m or is held_by an arm")
        return self


class Ignore(Table):
    """A pair of parts that the controller does not hold apart, nor the final check unless it is asked to. The user answers for it."""

    pair: tuple[Label, Label]
    reason: Annotated[Label, Field(min_length=1)]
    final_check: bool = False


class Bound(Table):
    """What a metric of the summary must be: an exact value, or a range."""

    min: Finite | None = None
    max: Finite | None = None
    equals: bool | Whole | Label | None = None

    @model_validator(mode="after")
    def _says_something(self) -> Bound:
        if self.min is None and self.max is None and self.equals is None:
            raise ValueError("a bound needs min, max or equals")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"min = {self.min:g} is above max = {self.max:g}")
        return self


class Change(Table):
    """Parameters of `[control]` that change while the scenario runs, as a person changes them in `workcell teleop`."""

    time_s: DurationOrZero
    t_min_s: Duration | None = None
    criterion: Label | None = None
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


class Check(Table):
    """The final check in its own process; docs/final_check.md says what is lost without it."""

    enabled: bool = True
    d_min_m: Length | None = None
    every_ticks: Annotated[int, Field(ge=1, le=10_000)] = 5
    stops_priority_arms: bool = False


class View(Table):
    """Where a live run is first looked at from; what is not given is chosen so that all tools are seen."""

    camera_azimuth_deg: Finite | None = None
    camera_elevation_deg: Annotated[float, Field(ge=-89, le=89, allow_inf_nan=False)] | None = None
    camera_distance_m: Positive | None = None


class Sabotage(Table):
    """Faults put into the controller on purpose, so that tests can see the final check stop it."""

    factor_multiplier: Annotated[float, Field(gt=0, le=1e12, allow_inf_nan=False)] = 1.0


class Variation(Table):
    """How a sweep draws one key: exactly one of a range, a normal distribution, choices, or a spread
    around the value in the file (entry by entry for a list)."""

    min: Whole | Finite | None = None
    max: Whole | Finite | None = None
    log: bool = False
    mean: Finite | None = None
    sd: Positive | None = None
    choices: Annotated[tuple[Any, ...], Field(min_length=1, max_length=MOST_ENTRIES)] | None = None
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


FORMAT = 1
"""Version of the tables; raised when a key changes its meaning, so that an older program does not misread it."""


def _readable(version: int) -> int:
    if version > FORMAT:
        raise ValueError(
            f"this program reads formats up to {FORMAT}; the file is for a newer one: update workcell"
        )
    return version


class Scenario(Table):
    """A whole scenario file, resolved: every default is filled in."""

    format: Annotated[int, Field(ge=1), AfterValidator(_readable)] = Field(FORMAT, exclude=True)
    name: Name
    description: Description = ""
    simulation: Simulation = Simulation()
    control: Control = Control()
    check: Check = Check()
    view: View = View()
    sabotage: Sabotage = Sabotage()
    arm: Annotated[tuple[Arm, ...], Field(min_length=1, max_length=MOST_ARMS)]
    obstacle: Annotated[tuple[Obstacle, ...], Field(max_length=MOST_THINGS)] = ()
    instrument: Annotated[tuple[Instrument, ...], Field(max_length=MOST_THINGS)] = ()
    ignore: Annotated[tuple[Ignore, ...], Field(max_length=MOST_THINGS)] = ()
    change: Annotated[tuple[Change, ...], Field(max_length=MOST_ENTRIES)] = ()
    strategy: dict[Label, dict[str, Any]] = Field(default_factory=dict, max_length=MOST_ENTRIES)
    criterion: dict[Label, dict[str, Any]] = Field(default_factory=dict, max_length=MOST_ENTRIES)
    expect: dict[Label, Annotated[Bound, BeforeValidator(_as_bound)]] = Field(
        default_factory=dict, max_length=MOST_ENTRIES
    )
    vary: dict[Label, Variation] = Field(default_factory=dict, max_length=MOST_ENTRIES)
    _file: Path | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _fits_together(self) -> Scenario:
        faults = fits_together(self) or plugin_faults(self)
        if faults:
            raise ValueError("\n".join(faults))
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
        content = {"format": FORMAT, **self.model_dump(mode="json")}
        return tomli_w.dumps(_without_none(content))

    def digest(self) -> str:
        """SHA-256 over the resolved content that a run depends on, independent of layout and comments of the file."""
        resolved = self.model_dump(mode="json", exclude={"vary", "view"})
        content = json.dumps(resolved, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(content.encode()).hexdigest()


def _without_none(value: Any) -> Any:
    """TOML has no null: a key that is None is left out."""
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [_without_none(v) for v in value]
    return value


def _kinds(union: Any) -> dict[str, type[Table]]:
    return {
        get_args(table.model_fields["kind"].annotation)[0]: table
        for table in get_args(get_args(union)[0])
    }


KINDS = _kinds(Operator) | _kinds(Job)
"""The table of each `kind` of operator and job."""
