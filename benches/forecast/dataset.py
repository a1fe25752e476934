"""Writes the set that both sides of the comparison read: 2,500 days x 60 features, standardised, in whole winters.

usage: dataset.py OUT.csv [decoded archive.csv]

With the decoded Lochaber archive (FIRN_SHARED_DATA or ../shared/data) its scorable days are used: 10 daily variables on three
days, and 30 sums, changes and indicators of them. It is then extended to 2,500 days by repeating whole winters, drawn with a
fixed seed, as new winters with normal noise of 0.3 standard deviations on every feature. This stands in for a larger archive of
which only Lochaber is at hand, so its scores mean nothing beyond "both sides agree".
Without the archive a seeded synthetic set of the same shape is drawn. The first line of OUT says which of the two it is.
Columns: label (0, 1), fold (0-4: winter modulo 5), 60 features.
"""

import csv
import datetime
import pathlib
import sys

import numpy as np

ROWS, FEATURES, FOLDS, SEED = 2500, 60, 5, 20261122
VARIABLES = ["air_temp_c", "wind_dir_deg", "wind_speed_mph", "cloud_pct", "drift", "foot_pen_cm", "rain_900",
             "snow_index", "insolation", "snow_temp_c"]


def number(text):
    return float(text) if text.strip() else np.nan


def days(path):
    """Values by season and date; a day whose activity is unknown has a NaN label."""
    seasons = {}
    with open(path, newline="", encoding="utf-8") as source:
        for row in csv.DictReader(source):
            day = {name: number(row[name]) for name in [*VARIABLES, "no_settle"]}
            day["label"] = number(row["aval_observed"])
            seasons.setdefault(int(row["season"]), {})[datetime.date.fromisoformat(row["date"])] = day
    return seasons


def features(winter, date):
    """60 features of one day of one winter; None where one of the two days before is missing."""
    past = [winter.get(date - datetime.timedelta(days=lag)) for lag in range(5)]
    if any(day is None for day in past[:3]):
        return None
    today, yesterday, before = past[:3]
    week = [day for day in past if day is not None]
    get = lambda name, among=past[:3]: np.array([day[name] for day in among])
    transport = (get("wind_speed_mph") * 0.44704) ** 3 * get("drift")
    air, snow, pen = get("air_temp_c"), get("snow_temp_c"), get("foot_pen_cm")
    direction, speed = np.radians(today["wind_dir_deg"]), today["wind_speed_mph"]
    season_day = (date - datetime.date(date.year if date.month >= 7 else date.year - 1, 7, 1)).days
    derived = [
        today["no_settle"], get("snow_index").sum(), get("snow_index", week).sum(), get("snow_index") @ [1, 0.5, 0.25],
        air[0] - air[1], air[0] - air[2], snow[0] - snow[1], snow[0] - snow[2], pen[0] - pen[1], pen[0] - pen[2],
        air.mean(), air.max(), np.maximum(air, 0).sum(), float(air[0] * air[1] < 0),
        snow[0] - air[0], (snow[0] - air[0]) - (snow[1] - air[1]), transport[0], transport.sum(),
        -speed * np.sin(direction), -speed * np.cos(direction),
        *(float(np.cos(direction - centre) > np.sqrt(0.5)) for centre in np.radians([0, 90, 180, 270])),
        float((get("rain_900") * (air > 0)).any()), float(today["cloud_pct"] > 80),
        float(yesterday["label"] == 1), float(before["label"] == 1),
        np.sin(2 * np.pi * season_day / 365.25), np.cos(2 * np.pi * season_day / 365.25),
    ]
    return [day[name] for day in past[:3] for name in VARIABLES] + derived


def from_archive(path, random):
    x, y, winters = [], [], []
    for winter, table in sorted(days(path).items()):
        for date in sorted(table):
            row = features(table, date)
            if row is not None and not np.isnan(table[date]["label"]):
                x.append(row), y.append(int(table[date]["label"])), winters.append(winter)
    x, y, winters = np.array(x), np.array(y), np.array(winters)
    x = np.where(np.isnan(x), np.nanmedian(x, axis=0), x)
    deviation = x.std(axis=0)
    x = (x - x.mean(axis=0)) / np.where(deviation > 0, deviation, 1)
    real, names = len(y), list(np.unique(winters))
    winters = np.searchsorted(names, winters)
    following = len(names)
    while len(y) < ROWS:
        chosen = np.flatnonzero(winters[:real] == random.integers(len(names)))[: ROWS - len(y)]
        x = np.vstack([x, x[chosen] + 0.3 * random.standard_normal((len(chosen), FEATURES))])
        y, winters = np.append(y, y[chosen]), np.append(winters, np.full(len(chosen), following))
        following += 1
    return x, y, winters, f"{real} scorable days of the Lochaber archive, extended by jittered winters"


def synthetic(random):
    x = random.standard_normal((ROWS, FEATURES)) @ np.linalg.qr(random.standard_normal((FEATURES, FEATURES)))[0]
    x[1:] = 0.6 * x[:-1] + 0.8 * x[1:]
    score = x[:, :10].sum(axis=1) + x[:, 0] * x[:, 1] + 3 * random.standard_normal(ROWS)
    return x, (score > np.quantile(score, 0.81)).astype(int), np.arange(ROWS) // 110, "synthetic"


def main():
    random = np.random.default_rng(SEED)
    archive = pathlib.Path(sys.argv[2]) if len(sys.argv) > 2 else None
    use_archive = archive is not None and archive.exists()
    x, y, winters, origin = from_archive(archive, random) if use_archive else synthetic(random)
    # rows ordered by fold would be no different: a winter is a block either way
    table = np.column_stack([y, winters % FOLDS, x])
    assert table.shape == (ROWS, FEATURES + 2)
    np.savetxt(sys.argv[1], table, delimiter=",", fmt=["%d", "%d"] + ["%.17g"] * FEATURES, header=origin)
    print(f"{ROWS} x {FEATURES}, {int(y.sum())} events: {origin}")


main()
