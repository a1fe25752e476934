"""The scikit-learn side: one JSON line with the same keys as the Rust side (svm.rs). usage: svm_sklearn.py SET.csv"""

import json
import sys
import time

import joblib
import numpy as np
import sklearn
from sklearn.metrics import roc_auc_score
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.model_selection import GridSearchCV, PredefinedSplit
from sklearn.svm import SVC

COSTS = [0.1, 0.3, 1, 3, 10, 30]
GAMMAS = [0.001, 0.003, 0.006, 0.01, 0.02, 0.03]
FITS = [(1.0, 0.003), (1.0, 0.01), (10.0, 0.003), (10.0, 0.01), (10.0, 0.03)]


def timed(work):
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


def eliminate(x, y, held_out, held_out_y, cost=1.0, gamma=0.01):
    """Order of removal and AUC at every size: Guyon's DJ over pairs of support vectors, one buffer for all features."""
    kept, removed, scores = list(range(x.shape[1])), [], []
    while True:
        machine = SVC(C=cost, gamma=gamma, class_weight="balanced", cache_size=500).fit(x[:, kept], y)
        if len(held_out_y):
            scores.append(roc_auc_score(held_out_y, machine.decision_function(held_out[:, kept])))
        if len(kept) == 1:
            return removed, scores
        support, beta = machine.support_vectors_, machine.dual_coef_[0]
        weighted = rbf_kernel(support, gamma=gamma) * np.outer(beta, beta)
        buffer, total, changes = np.empty_like(weighted), weighted.sum(), []
        for column in np.sqrt(gamma) * support.T:
            np.subtract.outer(column, column, out=buffer)
            np.multiply(buffer, buffer, out=buffer)
            np.exp(buffer, out=buffer)
            changes.append(abs(0.5 * (total - np.vdot(weighted, buffer))))
        removed.append(kept.pop(int(np.argmin(changes))))


def elimination(x, y, fold):
    """On all rows, and without each fold, which is scored; two processes, as the grid search has."""
    def split(name):
        training, test = fold != name, fold == name
        return joblib.delayed(eliminate)(x[training], y[training], x[test], y[test])
    runs = joblib.Parallel(n_jobs=2)(split(name) for name in [-1, *np.unique(fold)])
    return {"curve": np.mean([scores for _, scores in runs[1:]], axis=0).tolist(), "removed": runs[0][0]}


def main():
    table = np.loadtxt(sys.argv[1], delimiter=",")
    y, fold, x = table[:, 0].astype(int), table[:, 1].astype(int), np.ascontiguousarray(table[:, 2:])
    fits = []
    for c, gamma in FITS:
        machine = SVC(C=c, gamma=gamma, class_weight="balanced", cache_size=500)
        seconds, _ = timed(lambda: machine.fit(x, y))
        fits.append({"c": c, "gamma": gamma, "seconds": seconds, "decision": machine.decision_function(x).tolist()})
    search = GridSearchCV(SVC(class_weight="balanced", cache_size=500), {"C": COSTS, "gamma": GAMMAS},
                          scoring="roc_auc", cv=PredefinedSplit(fold), n_jobs=2, refit=False)
    seconds, _ = timed(lambda: search.fit(x, y))
    rfe_seconds, rfe = timed(lambda: elimination(x, y, fold))
    print(json.dumps({"version": f"scikit-learn {sklearn.__version__}", "fits": fits, "grid_seconds": seconds,
                      "auc": search.cv_results_["mean_test_score"].tolist(), "rfe_seconds": rfe_seconds} | rfe))


main()
