"""Two arms in plain mink, each sent to where the other is: with a time-to-collision limit they stop apart.

`TtcLimit` is a mink limit like any other, one row a pair: -G dq <= distance / t_min * dt. Any MJCF will do.
"""

import mink
import mujoco
import numpy as np

from workcell import PairWatch, TtcLimit, pairs_between
from workcell.assets import model_file

PERIOD_S, SIDES = 0.01, {"left": -0.5, "right": 0.5}
spec = mujoco.MjSpec()
for name, x_m in SIDES.items():
    arm = mujoco.MjSpec.from_file(str(model_file("planar3")))
    spec.attach(arm, prefix=f"{name}/", frame=spec.worldbody.add_frame(pos=[x_m, 0, 0]))
# Group 4 holds the capsules about the links. The watch adds a distance sensor a pair and compiles.
watch = PairWatch(spec, pairs_between(spec, "left/base", "right/base", group=4))


def drive(limits: list[mink.Limit]) -> tuple[float, float]:
    """Smallest distance (m) and smallest time to collision (s) on the way."""
    arms = mink.Configuration(watch.model, q=np.array([0.9, 0.6, 0.2, 2.2, -0.6, -0.2]))
    tasks = [mink.FrameTask(f"{name}/tool", "site", 1.0, 0.0, gain=0.02) for name in SIDES]
    tools = [arms.get_transform_frame_to_world(f"{name}/tool", "site") for name in SIDES]
    for task, other in zip(tasks, tools[::-1], strict=True):
        task.set_target(other)
    found = []
    for _ in range(300):
        velocity = mink.solve_ik(arms, tasks, PERIOD_S, "daqp", damping=1e-6, limits=limits)
        times = watch.times(arms.data, qvel=velocity)
        found.append((times.distance_m.min(), times.first.ttc_s))
        arms.integrate_inplace(velocity, PERIOD_S)
    return tuple(np.min(found, axis=0))


print("without the limit: {:.4f} m, {:.3f} s".format(*drive([])))
print("with the limit:    {:.4f} m, {:.3f} s".format(*drive([TtcLimit(watch, t_min_s=0.5)])))
