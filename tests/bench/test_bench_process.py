"""What a process of its own costs: the time to its first tick, and whether a long run's memory stays flat."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

COLD = """
import json, resource, tempfile, time
start = time.perf_counter()
from pathlib import Path
from workcell import run, scenario
from workcell.control.controller import Controller
from workcell.control.laws import arithmetic
used_arithmetic = arithmetic()
imported = time.perf_counter()
with tempfile.TemporaryDirectory() as folder:
    cell = run.prepare(scenario.load("handover"), Path(folder))
    controller = Controller(cell)
    built = time.perf_counter()
    qpos = controller._sensing.belief.data.qpos.copy()
    controller.step(qpos, 0 * qpos)
    ticked = time.perf_counter()
used = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps({
    "kernels": used_arithmetic, "imports_s": imported - start, "cell_s": built - imported, "first_tick_s": ticked - built,
    "cpu_s": used.ru_utime + used.ru_stime,
}))
"""

LONG = """
import json, sys, tempfile
from pathlib import Path
from workcell import run, scenario
seconds = float(sys.argv[1])
settings = ("simulation.plant=kinematic", "check.enabled=false", f"simulation.duration_s={seconds}")
def resident_mb():
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6
seen = []
with tempfile.TemporaryDirectory() as folder:
    cell = run.prepare(scenario.load("handover", settings), Path(folder) / "scene")
    def watch(tick, data, controller):
        if tick % 500 == 499:
            seen.append(resident_mb())
    run.simulate(cell, Path(folder), watch=watch)
    seen.append(resident_mb())
print(json.dumps(seen))
"""
LONG_RUN_S = 60.0
"""A tenth of the ten minutes that are meant; what grows with every tick shows in 30 000 of them."""
GROWTH_MB = 20.0
"""The trace's batches come and go by half a megabyte; anything kept a tick would exceed this."""

PEAK_MB = 400.0


def _python(source: str, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", source, *arguments], capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()[-1]


def test_cold_start(benchmark):
    json.loads(_python(COLD))  # Byte code and file caches are warm, as after the first use.
    found = json.loads(benchmark.pedantic(_python, (COLD,), rounds=1))
    benchmark.extra_info |= found
    print(f"\ncold start: {found}")
    assert found["first_tick_s"] < found["cell_s"], "nothing big may wait for the first tick"


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_of_a_long_run_is_flat(benchmark):
    seen = json.loads(benchmark.pedantic(_python, (LONG, str(LONG_RUN_S)), rounds=1))
    *running, closed = seen  # turning the journal into the trace takes memory of its own
    early, late = running[len(running) // 4], max(running)
    benchmark.extra_info |= {"early_mb": early, "late_mb": late, "closed_mb": closed}
    print(f"\nresident: {early:.0f} MB, later {late:.0f} MB, after closing {closed:.0f} MB")
    assert late - early < GROWTH_MB
    assert closed < PEAK_MB
