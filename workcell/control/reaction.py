"""What reaction and delay ask of t_min and of the task's gain.

Braking begins only after the reaction time: a control period, `[control] reaction_s`, and the age of the
state that the controller sees (`[simulation] latency_ticks`). t_min has to leave room for it and for the
braking itself (docs/theory.md section 5).

The tool's error is corrected by what was measured m ticks ago: e[n+1] = e[n] - k T e[n-m], with gain k and
period T. That is stable for k T < 2 sin(pi / (2 (2 m + 1))); half of it is allowed, a gain margin of two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import mink
import numpy as np

from workcell import scenario
from workcell.control.scaling import smallest_t_min
from workcell.scene.addresses import ArmAddresses
from workcell.scene.cell import Cell


def faults(cell: Cell) -> list[str]:
    """A gain that the delay makes unstable, and every t_min, in force now or later, that leaves no room to brake."""
    return [*_gain_faults(cell.scenario), *_t_min_faults(cell)]


def reaction_s(settings: scenario.Scenario) -> float:
    """Time from what happens to the first command that answers it."""
    simulation = settings.simulation
    period_s = simulation.period_s
    return period_s + settings.control.reaction_s + simulation.latency_ticks * period_s


def largest_gain_per_s(simulation: scenario.Simulation) -> float:
    """Largest gain of the tool's task with which its error still dies out, with a gain margin of two."""
    delayed = 2 * simulation.latency_ticks + 1
    return math.sin(math.pi / (2 * delayed)) / simulation.period_s


def smallest_t_min_s(cell: Cell, arm: str) -> float:
    """The smallest t_min that leaves a support arm room to brake from its fastest job; 0 for other arms.

    Against arms that keep coming where any other arm moves (theory, section 5), along the direction in which the
    joints brake the tool least, at home.
    """
    settings = cell.scenario
    fastest_m_s = _fastest_m_s(next(each for each in settings.arm if each.name == arm))
    if fastest_m_s == 0.0:
        return 0.0
    others_move = any(
        other.operator is not None and not isinstance(other.operator, scenario.Hold)
        for other in settings.arm
    )
    addresses = next(each for each in cell.arms if each.name == arm)
    deceleration = braking_deceleration_m_s2(cell, addresses)
    if math.isinf(deceleration):  # No joint moves the tool's point: there is nothing to brake.
        return 0.0
    return smallest_t_min(
        reaction_s(settings), fastest_m_s, deceleration, other_keeps_coming=others_move
    )


def braking_deceleration_m_s2(cell: Cell, addresses: ArmAddresses) -> float:
    """Deceleration of the tool along its path that the joints can give in the least favourable of the six axis directions, at home."""
    belief = mink.Configuration(cell.model)
    cell.place_home(belief.data)
    belief.update()
    jacobian = belief.get_frame_jacobian(addresses.tool_site_name, "site")[:3, addresses.dofs]
    # (n, 3): joint velocities for 1 m/s along each axis
    joint_rates = np.linalg.pinv(jacobian, rcond=1e-3)
    with np.errstate(divide="ignore"):
        return float(np.min(addresses.acceleration_limit_rad_s2[:, None] / np.abs(joint_rates)))


def _fastest_m_s(arm: scenario.Arm) -> float:
    """Largest speed of an arm's jobs, m/s; 0 for one without jobs that move."""
    return max(
        (job.speed_m_s for job in arm.job if not isinstance(job, scenario.Wait)), default=0.0
    )


def _gain_faults(settings: scenario.Scenario) -> Iterator[str]:
    gain, largest = settings.control.task_gain_per_s, largest_gain_per_s(settings.simulation)
    if gain > largest:
        simulation = settings.simulation
        late_s = simulation.latency_ticks * simulation.period_s
        yield (
            f"control.task_gain_per_s = {gain:g}: with period_s = {simulation.period_s:g} and a state that is {late_s:g} s old "
            f"(simulation.latency_ticks = {simulation.latency_ticks}) the tool would swing about its path; "
            f"allowed is {largest:.3g} or less"
        )


def _t_min_faults(cell: Cell) -> Iterator[str]:
    settings = cell.scenario
    given = {"control.t_min_s": settings.control.t_min_s} | {
        f"change.{k}.t_min_s": change.t_min_s
        for k, change in enumerate(settings.change)
        if change.t_min_s is not None
    }
    for arm in settings.arm:
        needed = smallest_t_min_s(cell, arm.name)
        for key, t_min_s in given.items():
            if t_min_s < needed:
                yield (
                    f"{key} = {t_min_s:g}: too small for arm {arm.name} to brake in from "
                    f"{_fastest_m_s(arm):g} m/s with a reaction time of "
                    f"{reaction_s(settings):.3g} s; allowed is {needed:.3f} s or more, or a lower speed_m_s"
                )
