"""A MuJoCo workcell in which tele-operated and autonomous arms share one space without colliding.

`from workcell import NAME` brings the parts listed in `__all__`; each is loaded when it is first asked for, so that
`import workcell` alone costs nothing.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

# No product here is large enough to share between threads: waking OpenBLAS's costs more than the
# product, up to milliseconds on a busy machine from about 700 watched pairs on. Sums made in one
# thread are also the same on every machine. Takes effect if NumPy has not been imported yet.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if TYPE_CHECKING:
    from workcell.control.commanded import Twist
    from workcell.control.criteria import (
        CRITERIA,
        NullspaceObjective,
        armd,
        artc_approaching,
        artc_signed,
        objective,
    )
    from workcell.control.gate import Gated, GateRules
    from workcell.control.ik.mink_tasks import CriterionTask, ToolTask, TtcLimit
    from workcell.control.proximity import Proximity
    from workcell.control.scaling import (
        FactorGovernor,
        ScaleBound,
        acceleration_interval,
        pairwise_factor,
        smallest_t_min,
    )
    from workcell.control.ttc import (
        SmallestTtc,
        reciprocal_first_order,
        reciprocal_second_order,
        smallest,
    )
    from workcell.errors import InputError, WorkcellError
    from workcell.parts.gate import CommandGate
    from workcell.parts.scaler import Scaled, SpeedScaler
    from workcell.parts.watch import PairTimes, PairWatch, pairs_between
    from workcell.scenario import Scenario
    from workcell.scenario import load as load_scenario
    from workcell.session import Session, State
    from workcell.trace.table import Trace
    from workcell.trace.table import load as load_trace

_HOMES = {
    "workcell.control.criteria": (
        "CRITERIA", "NullspaceObjective", "armd", "artc_approaching", "artc_signed", "objective",
    ),
    "workcell.control.gate": ("Gated", "GateRules"),
    "workcell.control.ik.mink_tasks": ("CriterionTask", "ToolTask", "TtcLimit"),
    "workcell.control.proximity": ("Proximity",),
    "workcell.control.scaling": (
        "FactorGovernor", "ScaleBound", "acceleration_interval", "pairwise_factor", "smallest_t_min",
    ),
    "workcell.control.ttc": (
        "SmallestTtc", "reciprocal_first_order", "reciprocal_second_order", "smallest",
    ),
    "workcell.control.commanded": ("Twist",),
    "workcell.errors": ("InputError", "WorkcellError"),
    "workcell.parts.gate": ("CommandGate",),
    "workcell.parts.scaler": ("Scaled", "SpeedScaler"),
    "workcell.parts.watch": ("PairTimes", "PairWatch", "pairs_between"),
    "workcell.scenario": ("Scenario", "load_scenario=load"),
    "workcell.session": ("Session", "State"),
    "workcell.trace.table": ("Trace", "load_trace=load"),
}  # fmt: skip
"""The public names of each module, `public=own` where they differ."""
_HOME_OF = {
    public: (module, own or public)
    for module, names in _HOMES.items()
    for public, _, own in (name.partition("=") for name in names)
}

__all__ = [
    "CRITERIA",
    "CommandGate",
    "CriterionTask",
    "FactorGovernor",
    "GateRules",
    "Gated",
    "InputError",
    "NullspaceObjective",
    "PairTimes",
    "PairWatch",
    "Proximity",
    "ScaleBound",
    "Scaled",
    "Scenario",
    "Session",
    "SmallestTtc",
    "SpeedScaler",
    "State",
    "ToolTask",
    "Trace",
    "TtcLimit",
    "Twist",
    "WorkcellError",
    "__version__",
    "acceleration_interval",
    "armd",
    "artc_approaching",
    "artc_signed",
    "load_scenario",
    "load_trace",
    "objective",
    "pairs_between",
    "pairwise_factor",
    "reciprocal_first_order",
    "reciprocal_second_order",
    "smallest",
    "smallest_t_min",
]


def __getattr__(name: str) -> Any:
    """Load a public name where it lives."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, own = _HOME_OF[name]
    value = globals()[name] = getattr(importlib.import_module(module), own)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
