"""A trace in pandas, and a picture of it: when was the nurse slowed, by which pair, how near was it then?

Takes a run folder; without one it makes a short run first. One row a tick, SI units (docs/trace.md).
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

from workcell import load_scenario, load_trace
from workcell.run import run

folder = Path(sys.argv[1]) if len(sys.argv) > 1 and Path(sys.argv[1]).is_dir() else None
if folder is None:
    folder = Path("runs/pandas")
    run(load_scenario("planar_crossing", ("simulation.duration_s=6", "expect={}")), folder)

trace = load_trace(folder)
columns = ["time_s", "ttc_s", "ttc_pair", "nurse.scale", "nurse.tool_speed_m_s", "nurse.reason"]
ticks = trace.table.select(columns).to_pandas().set_index("time_s")
ticks["nearest_m"] = trace["pair_distance_m"].min(axis=1)

slowed = ticks[ticks["nurse.scale"] < 1.0]
print(
    f"slowed for {len(slowed) / len(ticks):.0%} of the time, nearest {slowed['nearest_m'].min():.3f} m"
)
pairs = slowed["ttc_pair"].dropna().astype(int).map(lambda k: " - ".join(trace.layout.pairs[k]))
print(pairs.value_counts().head(3).to_string())

ticks[["nurse.scale", "nurse.tool_speed_m_s", "nearest_m"]].plot(subplots=True, figsize=(8, 6))
plt.savefig("trace.png")
