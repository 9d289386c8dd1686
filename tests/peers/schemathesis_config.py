"""Prints the configuration of Schemathesis for a farm: its checks, and ids of existing things.

usage: schemathesis_config.py THINGS.json
"""

import json
import sys

with open(sys.argv[1], encoding="utf-8") as file:
    things = json.load(file)

print(
    """
# A claim waits for up to a minute if the node has no task.
request-timeout = 75

[checks]
# What the document cannot say of a good request, the hooks do.
positive_data_acceptance.enabled = true

# This stream never ends.
[[operations]]
include-path = "/v1/events"
enabled = false

# A missing body is an empty one, which has a hash too.
[[operations]]
include-name = "PUT /v1/artifacts/{blake3}"
checks = { negative_data_rejection.enabled = false }

# A bundle is good or bad by what is in the file. The hook shortens waits.
[[operations]]
include-name = ["POST /v1/bundles", "POST /v1/leases"]
checks = { negative_data_rejection.enabled = false }

# Below the top, a list of an object's fields is read as the object.
[[operations]]
include-name = ["POST /v1/nodes", "POST /v1/nodes/join"]
checks = { negative_data_rejection.enabled = false }

# Ids of existing things, and some of missing ones.
[dictionaries]"""
)
for name, values in things.items():
    print(f"{name} = {{ values = {json.dumps(values)} }}")


def operations(pattern, **parameters):
    """Values for the paths of some operations, four times out of five."""
    chosen = (f'"path.{name}" = {{ dictionary = "{values}", probability = 0.8 }}' for name, values in parameters.items())
    print(f"\n[[operations]]\ninclude-path-regex = {json.dumps(pattern)}\nparameters = {{ {', '.join(chosen)} }}")


operations("^/v1/jobs/{id}/frames/", id="jobs", frame="frames")
operations("^/v1/jobs/{id}(/[a-z.-]+)*$", id="jobs")
operations("^/v1/jobs/{id}/frames/(retry|cancel)$", id="jobs")
operations("^/v1/leases/{id}", id="leases")
operations("^/v1/tasks/{id}", id="tasks")
operations("^/v1/webhooks/{id}", id="webhooks")
operations("^/v1/tokens/{id}", id="tokens")
operations("^/v1/plans/", id="plans")
operations("^/v1/bundles/", id="bundles")
operations("^/v1/nodes/{id}", id="nodes")
operations("^/v1/artifacts/", blake3="artifacts")
