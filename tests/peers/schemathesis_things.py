"""Makes things on a farm that Schemathesis then asks for, and prints their ids.

usage: schemathesis_things.py URL OPERATOR-TOKEN JOB.json
"""

import json
import sys
import time
import urllib.request

url, token = sys.argv[1:3]


def ask(method, path, body=None):
    """The JSON of an answer, or None if it has no body."""
    data = None if body is None else json.dumps(body).encode()
    headers = {"Authorization": "Bearer " + token, "Content-Type": "application/json"}
    request = urllib.request.Request(url + path, data, headers, method=method)
    with urllib.request.urlopen(request) as response:
        return json.loads(response.read() or "null")


with open(sys.argv[3], encoding="utf-8") as file:
    printed = json.load(file)
job, frames = printed["job"], printed["frames"]
node = ask("GET", "/v1/nodes")["items"][0]["id"]

# A second node takes a task of a second job. Then the job is cancelled, because the stream of an open job's
# events does not end.
ask("PATCH", f"/v1/nodes/{node}", {"pause": True})
second = ask("POST", "/v1/nodes", {"name": "second", "speed": 1.0, "price_per_hour": 0, "cores": 1})["id"]
small = {"width": 8, "height": 8, "spp": 1}
request = {"name": "second", "bundle": {"id": job["bundle"]["id"]}, "frames": "0-1", "settings": small}
second_job = ask("POST", "/v1/jobs", request)["id"]
lease = None
for _ in range(100):
    lease = ask("POST", "/v1/leases", {"node_id": second, "wait_ms": 0})
    if lease is not None:
        break
    time.sleep(0.1)
ask("POST", f"/v1/jobs/{second_job}/cancel")

# A third job is quoted, and waits to be accepted. The first node goes on with whatever comes.
ask("PATCH", f"/v1/nodes/{second}", {"drain": True})
ask("PATCH", f"/v1/nodes/{node}", {"pause": False})
open_job = ask("POST", "/v1/jobs", {**request, "name": "third", "hold": True})["id"]
for _ in range(600):
    if ask("GET", f"/v1/jobs/{open_job}")["state"] == "quoted":
        break
    time.sleep(0.1)
ask("PATCH", f"/v1/nodes/{second}", {"drain": False})
tokens = ask("GET", "/v1/tokens?page_size=200")["items"]
own_token = next(found["id"] for found in tokens if found["name"] == "first operator")
made_token = ask("POST", "/v1/tokens", {"name": "guest", "role": "viewer"})["token"]["id"]
webhook = ask("POST", "/v1/webhooks", {"url": "http://127.0.0.1:9/"})["id"]
ask("POST", "/v1/budgets", {"project": "default", "period": "month", "amount": 1_000_000_000, "zone": "UTC"})

absent = "0198c0de-0000-7000-8000-000000000000"
print(
    json.dumps(
        {
            "jobs": [job["id"], job["id"], second_job, absent],
            "open_jobs": [open_job],
            "frames": [0, 1, 7],
            "plans": [job["plan_id"], absent],
            "bundles": [job["bundle"]["id"], absent],
            "nodes": [node, second, absent],
            "leases": [lease["lease_id"], absent],
            "tasks": [lease["task_id"], absent],
            "tokens": [made_token, absent],
            "own_tokens": [own_token],
            "webhooks": [webhook, absent],
            "artifacts": [frames[0]["artifacts"]["image_png"], frames[0]["artifacts"]["image_exr"], "0" * 64],
        }
    )
)
