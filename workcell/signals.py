"""The list of logged quantities: every column of a trace is declared here, once.

A `Layout` (which arms, joints and watched pairs a scene has) turns the list into concrete columns:
an arm's quantity `scale` becomes `nurse.scale`, a quantity a pair becomes a vector as long as the
list of pairs. Columns of the trace, tolerances of the comparison and labels of plots all derive
from this list, so a new quantity is one line below.

This file knows neither how a trace is stored nor how a quantity is computed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

SCHEMA_VERSION = 1
"""Version of this list; raised when a column is renamed, dropped or changes its meaning."""

Shape = Literal["scalar", "nq", "nv", "pairs", "xyz", "wxyz"]
Dtype = Literal["float64", "int64", "int32", "string"]

STAGES = (
    "time", "plant", "state", "target", "proximity", "ttc", "criteria", "ik", "scaling", "check", "command",
    "mode",
)  # fmt: skip
"""Steps of a control tick in the order they are computed. Where two traces part in several
quantities at the same tick, the earliest stage is where to look for the cause."""


@dataclass(frozen=True)
class Signal:
    """One logged quantity.

    Two runs agree in it where |a - b| <= atol + rtol * |b|. Tolerances are chosen to let through
    what another processor or math library changes (a few 1e-12 a tick, grown over some thousand
    closed-loop ticks) and nothing a person would call another motion; names and counts are exact.
    """

    name: str
    """Column name, its last part the unit; for an arm's quantity without the arm."""
    unit: str
    """SI unit; "1" for a pure number, "" for names and indices."""
    shape: Shape
    """Length of one entry: one value, one a coordinate, one a watched pair, a point, a rotation."""
    dtype: Dtype
    """Type of one element."""
    atol: float
    """Largest accepted absolute difference, in the unit."""
    rtol: float
    """Largest accepted relative difference."""
    stage: str
    """Step of the control tick that produces it, one of `STAGES`."""
    meaning: str
    """One line for people."""
    nullable: bool = False
    """Whether there are ticks at which the quantity does not exist."""


@dataclass(frozen=True)
class Layout:
    """What of a scene fixes the width of the columns."""

    arms: tuple[str, ...]
    """Names of the arms, highest priority first."""
    joints: tuple[str, ...]
    """Names of the joints in the order of the model."""
    nq: int
    """Number of position coordinates."""
    nv: int
    """Number of velocity coordinates."""
    pairs: tuple[tuple[str, str], ...]
    """Names of the two geoms of every watched pair; a pair index counts in this tuple."""


@dataclass(frozen=True)
class Column:
    """One signal of one layout: what a trace really holds."""

    name: str
    """Name in the trace, `<arm>.<signal>` for an arm's quantity."""
    signal: Signal
    """What it is."""
    arm: str | None
    """Whose it is; None for a quantity of the whole cell."""
    width: int | None
    """Entries of a vector; None for a scalar."""


_S = Signal

CELL_SIGNALS: tuple[Signal, ...] = (
    _S("tick", "", "scalar", "int64", 0, 0, "time", "count of the control tick"),
    _S("time_s", "s", "scalar", "float64", 1e-12, 0, "time", "tick times period"),
    _S("plant_qpos", "rad", "nq", "float64", 1e-6, 0, "plant",
       "true positions; null where no plant took part", nullable=True),
    _S("plant_qvel", "rad/s", "nv", "float64", 1e-5, 0, "plant", "true velocities", nullable=True),
    _S("qpos", "rad", "nq", "float64", 1e-6, 0, "state", "positions the controller saw"),
    _S("qvel", "rad/s", "nv", "float64", 1e-5, 0, "state", "velocities the controller saw"),
    _S("pair_distance_m", "m", "pairs", "float64", 1e-6, 0, "proximity",
       "surface distance of each pair, negative when penetrating"),
    _S("pair_rate_m_s", "m/s", "pairs", "float64", 1e-5, 0, "proximity",
       "its rate from measured velocities, negative when closing"),
    _S("t_min_s", "s", "scalar", "float64", 1e-12, 0, "time",
       "smallest time to collision allowed now"),
    _S("criterion", "", "scalar", "string", 0, 0, "time", "null-space criterion now"),
    _S("entry", "", "scalar", "string", 0, 0, "time",
       "side from which presentations are asked to come; empty where each job has its own"),
    _S("closest_pair", "", "scalar", "int32", 0, 0, "proximity",
       "index of the pair with the smallest distance", nullable=True),
    _S("ttc_s", "s", "scalar", "float64", 1e-4, 1e-3, "ttc",
       "smallest time to collision from measured velocities; null where nothing closes",
       nullable=True),
    _S("ttc_pair", "", "scalar", "int32", 0, 0, "ttc", "pair it belongs to", nullable=True),
    _S("witness_i_m", "m", "xyz", "float64", 1e-6, 0, "ttc",
       "surface point on the first geom of the pair with the smallest time to collision, "
       "else of the closest pair", nullable=True),
    _S("witness_j_m", "m", "xyz", "float64", 1e-6, 0, "ttc",
       "the same on the second geom", nullable=True),
    _S("wanted_rad_s", "rad/s", "nv", "float64", 1e-5, 0, "ik",
       "joint velocities before scaling and checks"),
    _S("ttc_command_s", "s", "scalar", "float64", 1e-4, 1e-3, "scaling",
       "smallest time to collision from commanded velocities; null where nothing closes",
       nullable=True),
    _S("ttc_command_pair", "", "scalar", "int32", 0, 0, "scaling", "pair it belongs to",
       nullable=True),
    _S("check_distance_m", "m", "scalar", "float64", 1e-6, 0, "check",
       "smallest distance of the final check's own geometry; null when it is off", nullable=True),
    _S("check_state", "", "scalar", "string", 0, 0, "check", "what the final check says"),
    _S("command_rad_s", "rad/s", "nv", "float64", 1e-5, 0, "command",
       "joint velocities really commanded"),
    _S("holders", "", "scalar", "string", 0, 0, "target",
       "who holds each instrument, `name=arm`, nothing after the = where it lies"),
    _S("closing_cause", "", "scalar", "string", 0, 0, "command",
       "arm whose commanded motion closes the pair of ttc_command_s most; empty where nothing closes"),
    _S("mode", "", "scalar", "string", 0, 0, "mode",
       "which state acts: run, scale, self_motion, yield, hold, halt, stop"),
)  # fmt: skip
"""Quantities of the whole cell."""

ARM_SIGNALS: tuple[Signal, ...] = (
    _S("target_position_m", "m", "xyz", "float64", 1e-6, 0, "target", "wanted tool position"),
    _S("target_wxyz", "1", "wxyz", "float64", 1e-6, 0, "target", "wanted tool orientation"),
    _S("target_velocity_m_s", "m/s", "xyz", "float64", 1e-5, 0, "target", "its velocity"),
    _S("target_turn_rad_s", "rad/s", "xyz", "float64", 1e-5, 0, "target",
       "its angular velocity in the world frame"),
    _S("job", "", "scalar", "string", 0, 0, "target", "name of what drives the arm now"),
    _S("operator_state", "", "scalar", "string", 0, 0, "target",
       "valid, or the name of what is wrong with the operator's input; empty without an operator"),
    _S("path_s", "s", "scalar", "float64", 1e-5, 0, "target",
       "progress clock of the job: time along its path at full speed"),
    _S("tool_position_m", "m", "xyz", "float64", 1e-6, 0, "state", "tool position in the world"),
    _S("tool_wxyz", "1", "wxyz", "float64", 1e-6, 0, "state", "tool orientation in the world"),
    _S("tool_speed_m_s", "m/s", "scalar", "float64", 1e-5, 0, "state", "speed of the tool point"),
    _S("tool_error_m", "m", "scalar", "float64", 1e-6, 0, "state", "distance to the target"),
    _S("tool_error_rad", "rad", "scalar", "float64", 1e-6, 0, "state", "angle to the target"),
    _S("out_of_reach_m", "m", "scalar", "float64", 1e-6, 0, "target",
       "how far the tool will stay from a target beyond reach; null where it can be reached",
       nullable=True),
    _S("elbow_position_m", "m", "xyz", "float64", 1e-6, 0, "state",
       "elbow position in the world; null for an arm without one", nullable=True),
    _S("artc_per_s", "1/s", "scalar", "float64", 1e-5, 1e-4, "criteria",
       "average reciprocal time to collision over the arm's pairs"),
    _S("armd_per_m", "1/m", "scalar", "float64", 1e-4, 1e-4, "criteria",
       "average reciprocal distance over the arm's pairs"),
    _S("ik_status", "", "scalar", "string", 0, 0, "ik",
       "optimal, or the name of the fallback that answered"),
    _S("scale", "1", "scalar", "float64", 1e-5, 0, "scaling",
       "factor on the wanted joint velocities"),
    _S("limiting_pair", "", "scalar", "int32", 0, 0, "scaling",
       "pair that fixes the factor; null where none does", nullable=True),
    _S("reason", "", "scalar", "string", 0, 0, "command",
       "why the command differs from what was wanted, empty if it does not"),
    _S("gate", "", "scalar", "string", 0, 0, "command",
       "what the gate put in the place of the strategy's command, and why; empty where it passed"),
    _S("gate_pair", "", "scalar", "int32", 0, 0, "command",
       "pair of the first rule that it failed; null where none did", nullable=True),
    _S("attempt", "", "scalar", "string", 0, 0, "mode",
       "what is tried against an impasse, empty if there is none"),
    _S("mode", "", "scalar", "string", 0, 0, "mode", "which state acts on this arm"),
)  # fmt: skip
"""Quantities of each arm, logged as `<arm>.<name>`."""

_FIXED_WIDTHS = {"xyz": 3, "wxyz": 4}


def columns(layout: Layout) -> tuple[Column, ...]:
    """The columns of a trace of this layout, in order: the cell's, then arm by arm."""
    widths: dict[str, int | None] = {
        "scalar": None,
        "nq": layout.nq,
        "nv": layout.nv,
        "pairs": len(layout.pairs),
        **_FIXED_WIDTHS,
    }
    cell = [Column(s.name, s, None, widths[s.shape]) for s in CELL_SIGNALS]
    arms = [
        Column(f"{arm}.{s.name}", s, arm, widths[s.shape])
        for arm in layout.arms
        for s in ARM_SIGNALS
    ]
    return (*cell, *arms)
