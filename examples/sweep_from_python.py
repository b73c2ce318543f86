"""A sweep from Python: the same variations under two settings, on all cores, in one table.

The same as `workcell sweep planar_crossing --runs 2 --compare control.t_min_s=0.5,1.0`.
"""

from pathlib import Path

import pandas

from workcell.study import sweep
from workcell.study.workers import pool


def main(runs: int = 2) -> None:
    folder = Path("runs/sweep")
    plan = sweep.plan(
        "planar_crossing",
        runs=runs,
        seed=0,
        compare=("control.t_min_s=0.5,1.0",),
        overrides=("simulation.duration_s=4",),
    )
    with pool(None, None) as (workers, count):
        sweep.sweep(plan, folder, workers, ahead=2 * count, resume=folder.exists())
    table = pandas.read_parquet(folder / sweep.TABLE_FILE)
    for setting, rows in table.groupby("setting"):
        contacts = int((rows["contact_cause"] != "").sum())
        print(
            f"{setting}: {len(rows)} runs, {contacts} contacts, nearest {rows['smallest_m'].min():.4f} m"
        )


if __name__ == "__main__":  # the workers are processes, which import this file
    main()
