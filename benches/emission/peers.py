"""The peers' side of the bench: SciPy, and `powerlaw` from PyPI. One line of JSON a task. usage: peers.py FOLDER [fits]

The scans of `powerlaw` over all values take minutes; with `fits` only what takes seconds is run.
"""

import json
import pathlib
import sys
import time
import warnings

import numpy as np
import powerlaw
from scipy.spatial import cKDTree

warnings.filterwarnings("ignore")


def timed(task, work, **more):
    start = time.perf_counter()
    result = work()
    seconds = time.perf_counter() - start
    extra = {key: value() for key, value in more.items()}
    print(json.dumps({"task": task, "seconds": seconds, "result": result, **extra}), flush=True)


def scan(values, **options):
    fit = powerlaw.Fit(values, verbose=0, **options)
    return [float(fit.xmin), float(fit.power_law.alpha), float(fit.power_law.D)]


def exact_scan(values):
    """The definition in NumPy: every unique value but the largest, max |F - j/n|."""
    values = np.sort(values)
    logs = np.log(values)
    suffix = np.cumsum(logs[::-1])[::-1]
    best = (np.inf, 0.0, 0.0)
    starts = np.unique(values, return_index=True)[1][:-1]
    for i in starts:
        n = len(values) - i
        b = n / (suffix[i] - n * logs[i])
        distance = np.abs(1 - np.exp(-b * (logs[i:] - logs[i])) - np.arange(n) / n).max()
        if distance < best[0]:
            best = (distance, values[i], b + 1)
    return [float(best[1]), float(best[2]), float(best[0])]


def fits(values):
    xmin = values.min()
    names = {
        "power_law": ("power_law", ["alpha"]),
        "cutoff_power_law": ("truncated_power_law", ["alpha", "Lambda"]),
        "exponential": ("exponential", ["Lambda"]),
        "lognormal": ("lognormal", ["mu", "sigma"]),
        "stretched_exponential": ("stretched_exponential", ["Lambda", "beta"]),
    }
    for ours, (theirs, parameters) in names.items():
        holder = {}

        def work():
            fit = getattr(powerlaw.Fit(values, xmin=xmin, verbose=0), theirs)
            holder["loglik"] = float(np.sum(fit.loglikelihoods(values)))
            found = [float(getattr(fit, name)) for name in parameters]
            # our cut-off is the inverse of their rate
            return [found[0], 1 / found[1]] if ours == "cutoff_power_law" else found

        timed(f"fit {ours}", work, loglik=lambda: holder["loglik"])


def correlation(points):
    radii = np.exp(np.linspace(np.log(1e-3), np.log(1.8), 40))
    tree = cKDTree(points)
    pairs = (tree.count_neighbors(tree, radii) - len(points)) // 2
    return [int(count) for count in pairs]


def main():
    folder = pathlib.Path(sys.argv[1])
    quick = "fits" in sys.argv[2:]
    read = {name: np.loadtxt(folder / f"{name}.txt") for name in ("pareto_100k", "body_5k", "cutoff_10k", "points_50k")}
    for name in ("body_5k", "cutoff_10k"):
        timed(f"scan {name}", lambda: exact_scan(read[name]))
    timed("powerlaw scan body_5k", lambda: scan(read["body_5k"]))
    if not quick:
        timed("scan pareto_100k", lambda: exact_scan(read["pareto_100k"]))
    fits(read["cutoff_10k"])
    timed("C(r), 40 radii", lambda: correlation(read["points_50k"]))


main()
