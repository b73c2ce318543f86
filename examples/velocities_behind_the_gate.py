"""A plain velocity controller, and a broken one, behind the gate: neither gets the arm into the post.

The gate takes a joint velocity of any origin (a learned policy's, say) and answers with the same velocity if a stop
from it is verified, else with the nearest one that can be stopped, else with braking.
"""

import mujoco
import numpy as np

from workcell import CommandGate, GateRules, PairWatch, pairs_between
from workcell.assets import model_file

PERIOD_S = 0.01
spec = mujoco.MjSpec.from_file(str(model_file("planar3")))
post = spec.worldbody.add_body(name="post", pos=[0.4, 0.45, 0.3])
post.add_geom(name="post", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.08, 0, 0], group=4)
watch = PairWatch(spec, pairs_between(spec, "base", "post", group=4))
chance, goal = np.random.default_rng(0), np.array([1.8, 0.3, 0.2])


def drive(controller, gated: bool) -> float:
    """Smallest distance to the post on the way, m."""
    data, nearest_m = mujoco.MjData(watch.model), np.inf
    rules = GateRules(period_s=PERIOD_S, t_min_s=0.3, d_min_m=0.01, hold_m=0.005)
    gate = CommandGate(watch, [0, 1, 2], speed=[2, 2, 3], acceleration=[4, 4, 6], rules=rules)
    for _ in range(400):
        command = controller(data.qpos)
        if gated:
            command = gate.let_through(data, command).command
        data.qpos[:] += command * PERIOD_S
        nearest_m = min(nearest_m, watch.look(data).distance_m.min())
    return nearest_m


for law in (lambda q: 2.0 * (goal - q), lambda q: chance.uniform([-2, -4, -4], [6, 4, 4])):
    print(f"{drive(law, False):.4f} m without the gate, {drive(law, True):.4f} m behind it")
