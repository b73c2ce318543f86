"""What each stage of a tick costs in a run with everything logged, and how the cost grows.

Times of stages are taken inside one real run, by wrapping the stages' functions, so that caches
and allocations are a run's own. Garbage collection stays on and its pauses are counted.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from tests.bench.conftest import Stopwatch, drive, timed
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.control import controller, sensing
from workcell.control.arm_constraints import ArmConstraints
from workcell.control.controller import Controller
from workcell.control.ik import ArmIk
from workcell.control.laws import arithmetic
from workcell.control.laws import criteria as laws
from workcell.control.passage import Passage
from workcell.control.proximity import PairGeometry
from workcell.control.second_order import second_order
from workcell.control.setpoints import Setpoints
from workcell.control.watched import Watched
from workcell.scene import cell as scene
from workcell.trace.writer import TraceWriter

STAGES = (
    ("whole tick", Controller, "step"),
    ("witness points (MuJoCo)", mujoco, "mj_sensorPos"),
    ("distance, normal, G", PairGeometry, "measure"),
    ("rates, first-order times", Watched, "rates"),
    ("d̈", sensing, "second_order"),
    ("tool state and criterion: its values", ArmConstraints, "arm_state"),
    ("inverse kinematics: target", ArmIk, "aim"),
    ("inverse kinematics: criterion, rows, program", ArmConstraints, "solve"),
    ("scaling: factor and joints' reach", ArmConstraints, "allow"),
    ("scaling: is the command kept", ArmConstraints, "keeps"),
    ("gate", Passage, "let_through"),
    ("jobs and path", Setpoints, "_advance"),
    ("final check: hand-over", Controller, "_ask"),
    ("record of the tick", controller, "outcome"),
    ("log: a row", TraceWriter, "append"),
    ("plant", mujoco, "mj_step"),
)
RUN_S = 22.0
"""Long enough for all of the handover's jobs; the two orders together make 20 000 ticks."""


def _watched(owner, name: str, watch: Stopwatch):
    function = getattr(owner, name)
    return lambda *arguments, **keywords: watch.time(function, *arguments, **keywords)


@pytest.mark.parametrize("order", [1, 2])
def test_stages_of_a_run(benchmark, monkeypatch, tmp_path, order):
    overrides = (f"simulation.duration_s={RUN_S}", f"control.order={order}")
    built = runner.prepare(scenario_file.load("handover", overrides), tmp_path / "scene")
    watches = {name: Stopwatch() for name, *_ in STAGES}
    for name, owner, attribute in STAGES:
        monkeypatch.setattr(owner, attribute, _watched(owner, attribute, watches[name]))
    pauses: list[int] = []

    def collected(phase: str, _: dict) -> None:
        pauses.append(time.perf_counter_ns() * (1 if phase == "stop" else -1))

    gc.callbacks.append(collected)
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    try:
        ending = benchmark.pedantic(runner.simulate, (built, tmp_path), rounds=1)
    finally:
        gc.callbacks.remove(collected)
    cpu_s, wall_s = time.process_time() - cpu_s, time.perf_counter() - wall_s
    assert ending.fault is None
    rows = {
        name: watch.told() | {"calls_a_tick": round(len(watch) / ending.ticks, 2)}
        for name, watch in watches.items()
        if len(watch)
    }
    pause_us = (np.array(pauses[0::2]) + np.array(pauses[1::2])) / 1e3
    benchmark.extra_info |= {
        "stages": rows,
        "kernels": arithmetic(),
        "pairs": len(built.pairs),
        "ticks": ending.ticks,
        "times_real_time_wall": RUN_S / wall_s,
        "times_real_time_cpu": RUN_S / cpu_s,
        "collections": len(pause_us),
        "longest_collection_us": float(pause_us.max(initial=0.0)),
    }
    print(
        f"\n{arithmetic()}, order {order}: {RUN_S / wall_s:.2f} x real time by the wall, {RUN_S / cpu_s:.2f} by process time; "
        f"{len(pause_us)} collections, the longest {pause_us.max(initial=0.0):.0f} µs"
    )
    for name, row in rows.items():
        print(f"{name:46s}" + "".join(f"{key} {value:8.1f}  " for key, value in row.items()))


def test_pairs_alone(benchmark, cell, states):
    """Everything a pair costs beyond its witness points, for 64 pairs and up to 4000."""
    data = mujoco.MjData(cell.model)
    data.qpos[:], data.qvel[:] = states[-1]
    for step in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel, mujoco.mj_sensorPos):
        step(cell.model, data)
    found = {}
    for count in (64, 250, 1000, 4000):
        chosen = np.arange(count) % len(cell.pairs)
        geometry = PairGeometry(
            cell.model,
            [tuple(cell.pairs.geoms[k]) for k in chosen],
            np.asarray(cell.sensor_adr)[chosen],
        )

        watched = Watched(count, [arm.dofs for arm in cell.arms], cell.model.nv)
        near = geometry.measure(data, kept=True)
        watched.take(near, near.jacobian)
        criterion = _criterion(watched)

        def first(geometry=geometry, watched=watched, criterion=criterion):
            near = geometry.measure(data, kept=True)
            watched.take(near, near.jacobian)
            watched.rate_m_s[...] = watched.rates(data.qvel).rate_m_s
            criterion()

        def second(geometry=geometry, watched=watched, near=near):
            accel = second_order(geometry, data, near, np.zeros(cell.model.nv)).accel_m_s2
            watched.rates(data.qvel, accel)

        def without(watched=watched):
            watched.rates(data.qvel)

        found[count] = {"first": timed(first, 1000).told()}
        beside, instead = timed(second, 1000).told(), timed(without, 1000).told()
        found[count]["second"] = {
            key: round(value - instead[key], 1)
            for key, value in beside.items()
            if key.endswith("median_us")
        }
        print(
            f"\n{arithmetic()}, {count} pairs: first order {found[count]['first']}, d̈ {found[count]['second']}"
        )
    benchmark.extra_info |= {"pairs": found, "kernels": arithmetic()}
    benchmark(lambda: None)
    few, many = (found[count]["first"]["cpu_median_us"] for count in (64, 4000))
    print(f"{(many - few) / (4000 - 64):.3f} µs for a further pair")
    assert many <= few * 4000 / 64, "the cost must grow no faster than the number of pairs"


def _criterion(watched: Watched) -> Callable[[], object]:
    """ARTC and its gradient for all joints, on arrays that are kept."""
    pairs, joints = watched.jacobian.shape
    every, dofs = np.arange(pairs), np.arange(joints)
    hessian, linear = np.zeros((joints, joints)), np.zeros(joints)
    distance, rate = watched.distance_m, watched.rate_m_s

    def both() -> None:
        laws.means(distance, rate, every, False)
        laws.objective(
            laws.ARTC_SIGNED, watched.jacobian, distance, rate, rate, every, dofs, hessian, linear
        )

    return both


def test_tick_against_pairs_and_arms(benchmark, tmp_path):
    """The whole tick as obstacles and arms are added."""
    found = {}
    for name, arms, obstacles in (
        ("2 arms", 2, 0),
        ("2 arms, 10 more obstacles", 2, 10),
        ("2 arms, 60 more obstacles", 2, 60),
        ("3 arms", 3, 0),
        ("4 arms", 4, 0),
    ):
        content = scenario_file.load("handover").model_dump(exclude_none=True, exclude={"file"})
        content["expect"] = {}
        _add(content, arms, obstacles)
        built = scene.build(scenario_file.Scenario.model_validate(content), tmp_path / name)
        seen = iter(drive(built, 300) * 2)
        controller = Controller(built)
        watch = timed(lambda controller=controller, seen=seen: controller.step(*next(seen)), 300)
        found[name] = watch.told() | {"pairs": len(built.pairs)}
        print(f"\n{name}: {found[name]}")
    benchmark.extra_info["growth"] = found
    benchmark(lambda: None)


def _add(content: dict, arms: int, obstacles: int) -> None:
    """Arms that stand at the sides, holding their pose, and balls on a wall behind everything."""
    still = next(arm for arm in content["arm"] if arm.get("operator"))
    for k in range(arms - 2):
        content["arm"] = [
            *content["arm"],
            still
            | {
                "name": f"other{k}",
                "base_position_m": [1.4 * (-1) ** k, -0.6, 0.0],
                "priority": k + 2,
            },
        ]
    content["obstacle"] = [
        *content["obstacle"],
        *(
            {
                "name": f"ball{k}",
                "shape": "sphere",
                "size_m": [0.02],
                "position_m": [-0.9 + 0.2 * (k % 10), -0.5, 0.2 + 0.15 * (k // 10)],
            }
            for k in range(obstacles)
        ),
    ]
