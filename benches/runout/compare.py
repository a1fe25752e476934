"""Medians and ratios of the rounds of `run`, as a table in Markdown. usage: compare.py rates.jsonl"""

import collections
import json
import statistics
import sys

rates, centres = collections.defaultdict(list), {}
for line in open(sys.argv[1]):
    row = json.loads(line)
    key = (row["regime"], row["precision"], row["code"].split(" ")[0] + ", " + row.get("strains", "closed"))
    rates[key].append(row["particle_steps_per_s"] / 1e6)
    centres[key] = row["centre_m"]

print("| flow | precision | code, strains | median, M particle-steps/s | rounds | firn is faster by (each round) | centre of mass (m) |")
print("|---|---|---|---|---|---|---|")
for (regime, precision, code), values in sorted(rates.items()):
    ours = rates[regime, precision, "firn, closed"]
    ratios = "" if code.startswith("firn") else ", ".join(f"{a / b:.1f}" for a, b in zip(ours, values))
    x, z = centres[regime, precision, code]
    median = statistics.median(values)
    print(f"| {regime} | {precision} | {code} | {median:.1f} | {len(values)} | {ratios} | {x:.4f}, {z:.4f} |")
