"""A client that knows nothing of firn, OWSLib's `ogcapi.processes`, drives echo and a training from list to results.

usage: owslib_client.py URL      the server has a station `lochaber` that can train a model
"""

import sys
import time

from owslib.ogcapi.processes import Processes

PATIENCE_S = 300


def check(held, words):
    if not held:
        sys.exit(f"OWSLib: {words}")


def run(client, process, inputs):
    """Executes a process, follows its job by the links of its status document, and gives status and results."""
    job = client.execute(process, inputs=inputs, async_=True)
    location = client.response_headers["Location"]
    check(location.endswith(job["jobID"]), f"Location {location} is not that of job {job['jobID']}")
    check(client.response_headers["Preference-Applied"] == "respond-async", "respond-async was not heard")
    monitor = next(link["href"] for link in job["links"] if link["rel"] == "monitor")
    end = time.monotonic() + PATIENCE_S
    while job["status"] in ("accepted", "running"):
        check(time.monotonic() < end, f"{process} does not end: {job}")
        time.sleep(0.1)
        job = client._request(path=monitor)
    check(job["status"] == "successful", f"{process} did not succeed: {job}")
    results = next(link["href"] for link in job["links"] if link["rel"].endswith("/results"))
    return job, client._request(path=results)


def main(url):
    client = Processes(f"{url}/v1")
    classes = client.conformance()["conformsTo"]
    check(any(name.endswith("/conf/core") for name in classes), "core is not declared")
    listed = {process["id"] for process in client.processes()}
    check({"echo", "train-model"} <= listed, f"listed are {listed}")

    echo = client.process("echo")
    check(echo["inputs"]["message"]["schema"]["type"] == "string", f"echo is described as {echo}")
    check("async-execute" in echo["jobControlOptions"], f"echo is described as {echo}")
    _, results = run(client, "echo", {"message": "hello", "delay_s": 0.5})
    check(results == {"message": "hello"}, f"echo gave {results}")
    try:
        client.execute("echo", inputs={"message": 1})
        check(False, "inputs against the schema were accepted")
    except RuntimeError as refusal:
        check("/inputs/message" in str(refusal), f"the refusal does not name the field: {refusal}")

    # a seed of its own: nothing that was computed before is the answer
    training = client.process("train-model")["example"]["inputs"] | {"seed": 20261122}
    job, results = run(client, "train-model", training)
    check(not job["reused"] and job["progress"] == 100, f"the training is {job}")
    check(results["model_id"] and results["scores"], f"the training gave {results}")

    newest = client._request(path="jobs", kwargs={"processID": "train-model", "limit": 1})["jobs"]
    check([entry["jobID"] for entry in newest] == [job["jobID"]], f"the newest training is {newest}")
    print("OWSLib drove echo and a training from list to results")


if __name__ == "__main__":
    main(sys.argv[1])
