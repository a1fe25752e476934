"""The scikit-learn side: one JSON line with the same keys as the Rust side (svm.rs). usage: svm_sklearn.py SET.csv"""

import json
import sys
import time

import numpy as np
import sklearn
from sklearn.model_selection import GridSearchCV, PredefinedSplit
from sklearn.svm import SVC

COSTS = [0.1, 0.3, 1, 3, 10, 30]
GAMMAS = [0.001, 0.003, 0.006, 0.01, 0.02, 0.03]
FITS = [(1.0, 0.003), (1.0, 0.01), (10.0, 0.003), (10.0, 0.01), (10.0, 0.03)]


def timed(work):
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


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
    print(json.dumps({"version": f"scikit-learn {sklearn.__version__}", "fits": fits, "grid_seconds": seconds,
                      "auc": search.cv_results_["mean_test_score"].tolist()}))


main()
