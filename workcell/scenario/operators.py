"""Who drives an arm that is not autonomous: one table for each `kind` of operator."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from workcell import plugins
from workcell.errors import InputError
from workcell.scenario.values import (
    MOST_JOBS,
    MOST_WAYPOINTS,
    Acceleration,
    AngleOrZero,
    Duration,
    DurationOrZero,
    FileName,
    Length,
    LengthOrZero,
    Name,
    Probability,
    Quaternion,
    Speed,
    Table,
    Turn,
    Vector3,
)


class Hold(Table):
    """The arm keeps the tool pose it starts with."""

    kind: Literal["hold"]


class Waypoint(Table):
    """A tool pose in the world; without `wxyz` the orientation of the waypoint before is kept."""

    position_m: Vector3
    wxyz: Quaternion | None = None


class Waypoints(Table):
    """The tool follows a smooth path through waypoints, starting where it is; then, `repeat` times, back and forth along them."""

    kind: Literal["waypoints"]
    waypoints: Annotated[tuple[Waypoint, ...], Field(min_length=1, max_length=MOST_WAYPOINTS)]
    speed_m_s: Speed = 0.15
    acceleration_m_s2: Acceleration = 0.5
    start_s: DurationOrZero = 0.0
    repeat: Annotated[int, Field(ge=0, le=MOST_JOBS)] = 0
    pause_s: DurationOrZero = 0.0


class Followed(Table):
    """An input that may leap: caps on the target that follows it, and what counts as a leap."""

    max_speed_m_s: Speed = 0.5
    max_acceleration_m_s2: Acceleration = 2.0
    max_turn_rad_s: Speed = 1.0
    max_turn_rad_s2: Acceleration = 4.0
    jump_m: Length = 0.05
    jump_rad: Turn = 0.35
    jump_confirm_s: DurationOrZero = 0.1


class Recording(Followed):
    """The tool follows a recorded stream of poses; docs/teleop.md has the format and the rules."""

    kind: Literal["recording"]
    file: FileName
    start_s: DurationOrZero = 0.0
    gap_s: Duration = 0.25


class Streamed(Followed):
    """Samples that come as they come; times are those after which a fault is named."""

    stale_s: Duration = 0.1
    late_s: Duration = 0.1
    frozen_s: DurationOrZero = 0.0


class Live(Streamed):
    """A person, through `workcell teleop`; with `device` through one that a plug-in brings."""

    kind: Literal["live"]
    device: Name | None = None
    device_options: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _device_is_there(self) -> Live:
        if self.device is None:
            if self.device_options:
                raise ValueError("device_options needs a device")
            return self
        try:
            plugins.options("devices", self.device, self.device_options)
        except InputError as error:
            raise ValueError("; ".join(error.faults)) from error
        return self


class Stream(Streamed):
    """How a simulated person's hand is seen: a sampled stream with faults, followed as a live one is."""

    rate_hz: Annotated[float, Field(ge=1, le=1000, allow_inf_nan=False)] = 30.0
    jitter_s: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = 0.0
    gap_probability: Probability = 0.0
    gap_s: tuple[Duration, Duration] = (0.1, 0.5)
    burst_probability: Probability = 0.0
    burst_s: Duration = 0.2
    spike_probability: Probability = 0.0
    spike_m: Length = 0.5
    identity_probability: Probability = 0.0

    @model_validator(mode="after")
    def _gap_has_an_order(self) -> Stream:
        if self.gap_s[0] > self.gap_s[1]:
            raise ValueError("gap_s is the shortest and the longest gap, in this order")
        return self


class Human(Table):
    """A simulated person who works at sites; positions are in the world. With the later keys a hostile one."""

    kind: Literal["human"]
    sites: Annotated[tuple[Waypoint, ...], Field(min_length=1, max_length=MOST_WAYPOINTS)]
    speed_m_s: Speed = 0.2
    acceleration_m_s2: Acceleration = 0.5
    pause_s: tuple[Duration, Duration] = (0.3, 2.0)
    stop_probability: Probability = 0.3
    withdraw_probability: Probability = 0.1
    withdraw_m: Vector3 = (0.0, 0.0, 0.10)
    withdraw_speed_m_s: Speed = 0.4
    withdraw_acceleration_m_s2: Acceleration = 1.5
    elbow_probability: Probability = 0.1
    elbow_shift_m: Length = 0.05
    tremor_m: LengthOrZero = 6e-5
    start_s: DurationOrZero = 0.5
    reach_out_probability: Probability = 0.0
    reach_out_m: Length = 0.8
    reach_out_speed_m_s: Speed = 0.5
    flick_probability: Probability = 0.0
    flick_m: Length = 0.15
    flick_rad: AngleOrZero = 0.5
    reversal_probability: Probability = 0.0
    reversal_m: Length = 0.1
    reversal_count: Annotated[int, Field(ge=1, le=100)] = 4
    fast_speed_m_s: Speed = 2.0
    fast_acceleration_m_s2: Acceleration = 15.0
    stream: Stream | None = None

    @model_validator(mode="after")
    def _pause_has_an_order(self) -> Human:
        if self.pause_s[0] > self.pause_s[1]:
            raise ValueError("pause_s is the shortest and the longest pause, in this order")
        return self


class Joints(Table):
    """The arm repeats the joint motion of an arm of a recorded run, tick by tick; for fair races."""

    kind: Literal["joints"]
    run: FileName
    arm: Name | None = None


class Plugin(Table):
    """An operator that a plug-in brings, with the options that it takes."""

    kind: Literal["plugin"]
    name: Name
    options: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _is_there(self) -> Plugin:
        try:
            plugins.options("operators", self.name, self.options)
        except InputError as error:
            raise ValueError("; ".join(error.faults)) from error
        return self


Operator = Annotated[
    Hold | Waypoints | Recording | Human | Live | Joints | Plugin, Field(discriminator="kind")
]
