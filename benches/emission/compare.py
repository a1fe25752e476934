"""Medians, ratios and agreement of the rounds that `run` left in a folder; exit status 1 if the two sides disagree.

The speeds wanted are printed and do not change the exit status: a busy machine must not turn a bench red.
"""

import json
import os
import pathlib
import statistics
import sys

TOLERANCE = 1e-6
# what the optimiser of `powerlaw` leaves in two parameters; where it does, ours must have the larger likelihood
LOOSE = 2e-3
WANTED = {"scan pareto_100k": 0.5, "p, 2500 replicates": 5.0, "C(r), 40 radii": 2.0}


def rounds(folder, side):
    return [{line["task"]: line for line in map(json.loads, path.read_text().splitlines())}
            for path in sorted(folder.glob(f"{side}.*.json"))]


def agree(task, ours, theirs):
    """Whether the results agree, and how far they are apart, in relative terms."""
    apart = max((abs(a - b) / max(abs(b), 1e-300) for a, b in zip(ours["result"], theirs["result"], strict=True)), default=0.0)
    if apart <= TOLERANCE:
        return True, f"{apart:.0e}"
    better = "loglik" in ours and ours["loglik"] >= theirs["loglik"] and apart <= LOOSE
    return better, f"{apart:.0e}" + (f", our log likelihood is {ours['loglik'] - theirs['loglik']:.1e} higher" if better else "")


def main():
    folder = pathlib.Path(sys.argv[1])
    ours, theirs = rounds(folder, "firn"), rounds(folder, "peers")
    load = " ".join(f"{value:.1f}" for value in os.getloadavg())
    print(f"{os.cpu_count()} cores, load {load}; {len(ours)} rounds of firn, {len(theirs)} of the peers, alternating")
    print(f"{'median of rounds':28} {'firn':>10} {'peer':>10} {'ratio':>8}  apart")
    good = True
    for task, first in ours[0].items():
        mine = statistics.median(r[task]["seconds"] for r in ours)
        others = [r[task] for r in theirs if task in r]
        line = f"{task:28} {mine:8.4f} s"
        if others:
            other = statistics.median(r["seconds"] for r in others)
            same, apart = agree(task, first, others[0])
            good &= same
            line += f" {other:8.3f} s {other / mine:6.0f} x  {apart}{'' if same else '  DISAGREE'}"
        if task in WANTED:
            line += f"  (wanted: at most {WANTED[task]} s)"
        print(line)
    same = all(r[task]["result"] == ours[0][task]["result"] for r in ours for task in r)
    print(f"firn gives the same bits in every round: {same}")
    sys.exit(0 if good and same else 1)


main()
