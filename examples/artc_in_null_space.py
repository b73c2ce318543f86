"""A seven-joint arm holds its tool where it is while a ball comes at its elbow: the elbow makes way.

`CriterionTask` is a mink task: the average reciprocal time to collision (ARTC) over the watched pairs, to be lowered
by self-motion. The tool's task stands beside it as a constraint, so that the two are never traded.
"""

import mink
import mujoco
import numpy as np

from workcell import CriterionTask, PairWatch, pairs_between
from workcell.assets import model_file

PERIOD_S, HOME = 0.01, np.array([0.0, 0.6, 0.0, 1.4, 0.0, 0.8, 0.0])
spec = mujoco.MjSpec.from_file(str(model_file("pa10")))
ball = spec.worldbody.add_body(name="ball", mocap=True)
ball.add_geom(name="ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0, 0], group=4)
watch = PairWatch(spec, pairs_between(spec, "base", "ball", group=4))


def drive(gain: float) -> np.ndarray:
    """Smallest distance to the ball, and largest way of the tool from its place, m."""
    arm = mink.Configuration(watch.model, q=HOME)
    tool = mink.FrameTask("tool", "site", 1.0, 1.0)
    tool.set_target_from_configuration(arm)
    elbow = CriterionTask(range(7), nv=7, dt_s=PERIOD_S, gain=gain, geometry=watch)
    found = []
    for tick in range(300):
        arm.data.mocap_pos[0] = [0.2, 0.75 - 0.15 * tick * PERIOD_S, 0.75]
        velocity = mink.solve_ik(arm, [elbow], PERIOD_S, "daqp", limits=[], constraints=[tool])
        arm.integrate_inplace(velocity, PERIOD_S)
        off_m = np.linalg.norm(tool.compute_error(arm)[:3])
        found.append((watch.look(arm.data).distance_m.min(), -off_m))
    return np.min(found, axis=0) * [1, -1]


for gain in (0.0, 8.0):
    nearest_m, off_m = drive(gain)
    print(f"gain {gain:g}: distance to the ball >= {nearest_m:.4f} m, tool within {off_m:.6f} m")
