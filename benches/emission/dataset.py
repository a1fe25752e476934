"""Writes the samples of the bench into a folder; the seeds are fixed. usage: dataset.py FOLDER"""

import pathlib
import sys

import numpy as np


def pareto(rng, n, alpha, xmin):
    return xmin * (1 - rng.random(n)) ** (-1 / (alpha - 1))


def with_body(rng, n, alpha):
    """x^-alpha above 1, joined by exp(-alpha (x - 1)) below (Clauset, Shalizi & Newman 2009, eq. 3.10)."""
    below, above = (np.exp(alpha) - 1) / alpha, 1 / (alpha - 1)
    bodies = rng.binomial(n, below / (below + above))
    body = -np.log(1 - rng.random(bodies) * (1 - np.exp(-alpha))) / alpha
    return np.concatenate([body, pareto(rng, n - bodies, alpha, 1.0)])


def with_cutoff(rng, n, alpha, xmin, cutoff):
    found = np.empty(0)
    while len(found) < n:
        x = pareto(rng, 4 * n, alpha, xmin)
        found = np.concatenate([found, x[rng.random(4 * n) < np.exp(-(x - xmin) / cutoff)]])
    return found[:n]


def main():
    folder = pathlib.Path(sys.argv[1])
    rng = np.random.default_rng(20050401)
    for name, values in {
        "pareto_100k": pareto(rng, 100_000, 2.0, 1.0),
        "body_5k": with_body(rng, 5000, 2.5),
        "cutoff_10k": with_cutoff(rng, 10_000, 1.35, 0.003, 0.1),
        "points_50k": rng.random((50_000, 3)),
    }.items():
        np.savetxt(folder / f"{name}.txt", values, fmt="%.17g")


main()
