"""`python -m tests.fuzz`: make every target's cases over worker processes, and print a table of what came out.

Each batch of cases is a process of its own, so that one that hangs in compiled code or is killed costs no
other batch. A case is found again by its target and seed: `--only scenario --first 17 --count 1`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from tests.fuzz import harness
from tests.fuzz.targets import TARGETS

COUNTS = {"scenario": 3000, "arm": 1000, "recording": 1000, "run_folder": 500, "command_line": 300}
"""Cases of a whole campaign."""
BATCH = 50
BATCH_S = 900.0
"""After which a batch counts as hung: fifty cases of one slow call each, and some."""
Result = dict[str, Any]


def main() -> int:
    """Exit status 1 if any case had a fault."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--only", choices=sorted(TARGETS), help="one target")
    parser.add_argument("--count", type=int, help="cases of each target")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--here", action="store_true", help="in this process, a line a case")
    options = parser.parse_args()
    names = [options.only] if options.only else list(TARGETS)
    if options.here:
        for name in names:
            for case in harness.run(
                name, TARGETS[name], range(options.first, options.first + options.count)
            ):
                print(json.dumps(_result(case)), flush=True)
        return 0
    batches = [
        (name, first, min(BATCH, end - first))
        for name in names
        for end in [options.first + (options.count or COUNTS[name])]
        for first in range(options.first, end, BATCH)
    ]
    done: list[Result] = []
    with ThreadPoolExecutor(options.workers) as pool:
        for results in pool.map(lambda batch: list(_batch(*batch)), batches):
            for result in results:
                for fault in result["faults"]:
                    print(f"{result['target']} {result['seed']}: {fault}", flush=True)
            done += results
    for call in sorted((c for r in done for c in r["calls"]), key=lambda c: -c["took_s"])[:5]:
        print(f"{call['took_s']:.1f} s: {call['command']} {call['status']} {call['err']!r}")
    print(table(done))
    return 1 if any(result["faults"] for result in done) else 0


def _batch(name: str, first: int, count: int) -> Iterator[Result]:
    """The cases of one process, and one fault more where it did not come to its end."""
    command = [sys.executable, "-m", "tests.fuzz", "--here", "--only", name]
    command += ["--first", str(first), "--count", str(count)]
    ended = ""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=BATCH_S, check=False)
        lines = done.stdout.splitlines()
        if done.returncode:
            ended = f"the process ended with {done.returncode}: {done.stderr[-500:]}"
    except subprocess.TimeoutExpired as late:
        lines = (late.stdout or b"").decode().splitlines()
        ended = f"the process took more than {BATCH_S:g} s"
    results = [json.loads(line) for line in lines if line.startswith("{")]
    yield from results
    if ended:
        seed = first + len(results)
        yield {"target": name, "seed": seed, "faults": [ended], "calls": [], "judged": 0}


def _result(case: harness.Case) -> Result:
    calls = [
        {"command": c.arguments[:1], "status": c.status, "took_s": c.took_s, "err": c.err[:300]}
        for c in case.calls
    ]
    faults = [
        f"{fault}\n{case.calls[-1].err[-1500:]}"
        if "None" in fault or "traceback" in fault
        else fault
        for fault in case.faults
    ]
    return {
        "target": case.target,
        "seed": case.seed,
        "faults": faults,
        "calls": calls,
        "judged": case.judged,
    }


def table(results: list[Result]) -> str:
    """Counts a target: cases, calls by exit status, runs judged, cases with a fault, the longest call."""
    lines = [
        "| target | cases | calls | status 0 | 1 | 2 | runs judged | faults | longest call |",
        "|" + " --- |" * 9,
    ]
    for name in dict.fromkeys(result["target"] for result in results):
        mine = [result for result in results if result["target"] == name]
        calls = [call for result in mine for call in result["calls"]]
        by_status = Counter(call["status"] for call in calls)
        longest = max((call["took_s"] for call in calls), default=0.0)
        judged = sum(result["judged"] for result in mine)
        faults = sum(bool(result["faults"]) for result in mine)
        lines.append(
            f"| {name} | {len(mine)} | {len(calls)} | {by_status[0]} | {by_status[1]} | {by_status[2]} | {judged} | {faults} | {longest:.1f} s |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
