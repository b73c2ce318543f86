"""The gate in front of any controller: nothing that comes out of it leads into a wall."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.parts import scenes
from workcell import CommandGate, GateRules, InputError, PairWatch, pairs_between

RULES = GateRules(period_s=0.01, t_min_s=0.2, d_min_m=0.005)


def arms() -> tuple[PairWatch, CommandGate]:
    spec = scenes.two_arms()
    watch = PairWatch(spec, pairs_between(spec, "left/base", "right/base", group=4))
    return watch, CommandGate(
        watch, [0, 1, 2], speed=[2, 2, 3], acceleration=[4, 4, 6], rules=RULES
    )


def test_random_commands_never_touch_an_arm_that_stands():
    rng = np.random.default_rng(1)
    watch, gate = arms()
    data = mujoco.MjData(watch.model)
    data.qpos[:] = [0.9, 0.6, 0.2, 2.2, -0.6, -0.2]
    nearest_m, passed, command = np.inf, 0, np.zeros(3)
    for tick in range(600):
        if tick % 20 == 0:
            command = rng.uniform(-3, 2, 3)
        answer = gate.let_through(data, command)
        passed += not answer.replaced
        assert np.array_equal(gate.last, answer.command)
        data.qpos[:3] += answer.command * RULES.period_s
        nearest_m = min(nearest_m, watch.look(data).distance_m.min())
    assert 0.0 < nearest_m < 0.1, "it came near and did not touch"
    assert 0 < passed < 600


def test_what_cannot_pass_is_replaced_and_says_why():
    watch = PairWatch(scenes.slide(), [("ball", "wall")])
    data = mujoco.MjData(watch.model)
    rules = GateRules(period_s=0.01, t_min_s=0.5)
    gate = CommandGate(watch, [0], speed=[1.0], acceleration=[50.0], rules=rules)
    assert gate.let_through(data, [0.3]).how == "passed"
    assert gate.let_through(data, [float("nan")]).reasons == ("not_finite",)
    assert gate.let_through(data, [3.0]).reasons[0] in ("speed", "acceleration")
    data.qpos[0], data.qvel[1] = 0.85, 5.0
    near = gate.let_through(data, [0.8])
    assert "time_to_collision" in near.reasons
    assert near.pair == 0
    assert near.command[0] <= 0.1 / 0.5 + 1e-4
    gate.reset(last=[0.1])
    assert gate.last == pytest.approx([0.1])


def test_other_joints_are_counted_on_as_told():
    watch = PairWatch(scenes.slide(), [("ball", "second")])
    data = mujoco.MjData(watch.model)
    gates = [
        CommandGate(watch, [0], speed=[1.0], acceleration=[50.0], rules=RULES) for _ in range(2)
    ]
    data.qpos[0] = 0.4
    stands, comes = (
        gate.let_through(data, [0.5], others=[0.0, y])
        for gate, y in zip(gates, (0.0, 9.0), strict=True)
    )
    assert stands.command[0] == pytest.approx(0.5)
    assert comes.command[0] < 0.5


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"speed": [1.0]}, "speed"),
        ({"acceleration": [4, 4, 0]}, "acceleration[2]"),
        ({"rules": GateRules(period_s=0.0, t_min_s=1.0)}, "rules.period_s"),
        ({"rules": GateRules(period_s=0.01, t_min_s=0.0)}, "rules.t_min_s"),
        ({"rules": GateRules(period_s=0.01, t_min_s=1.0, latency_s=-1.0)}, "rules.latency_s"),
        ({"dofs": [0, 1, 6]}, "dofs"),
    ],
)
def test_settings_out_of_range_are_refused_by_name(change, word):
    watch, _ = arms()
    given = {"dofs": [0, 1, 2], "speed": [2, 2, 3], "acceleration": [4, 4, 6], "rules": RULES}
    given |= change
    with pytest.raises(InputError) as caught:
        CommandGate(watch, given.pop("dofs"), **given)
    assert str(caught.value).startswith(word)


def test_commands_and_joints_of_another_kind_are_refused():
    watch, gate = arms()
    data = mujoco.MjData(watch.model)
    with pytest.raises(InputError, match=r"command has shape \(2,\)"):
        gate.let_through(data, [0.0, 0.0])
    with pytest.raises(InputError, match="others"):
        gate.let_through(data, np.zeros(3), others=np.zeros(3))
    free = scenes.slide(
        '<body name="loose"><freejoint/><geom name="loose" size="0.1" mass="1"/></body>'
    )
    loose = PairWatch(free, [("loose", "wall")])
    with pytest.raises(InputError, match="hinge and slide"):
        CommandGate(loose, [2], speed=[1.0], acceleration=[1.0], rules=RULES)
