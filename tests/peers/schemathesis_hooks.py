"""Tells Schemathesis what a schema cannot say of a good request: which things exist, that a deadline is to come,
that of two fields one is given. Bad requests are left as they are."""

import datetime
import io
import json
import os
import pathlib
import uuid
import zipfile

import schemathesis
from hypothesis import strategies

things = json.loads(os.environ["FORELIGHT_THINGS"])
bundle_id = os.environ["FORELIGHT_EXAMPLE_BUNDLE"]

# BLAKE3 of nothing.
HASH_OF_NOTHING = "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262"


def packed(files):
    """A zip file of these names and contents."""
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files:
            archive.writestr(name, content)
    return target.getvalue()


def scene():
    """A scene of deploy/scenes, as a bundle."""
    folder = pathlib.Path(os.environ["FORELIGHT_EXAMPLE_SCENE"])
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return packed((str(path.relative_to(folder)), path.read_bytes()) for path in files)


good = scene()
names = strategies.sampled_from(["scene.json", "scene.obj", "../scene.json", "/scene.json", "a/" * 90 + "b"])
contents = strategies.binary(max_size=64)
archives = strategies.dictionaries(names, contents, max_size=3).map(lambda files: packed(files.items()))
bundles = strategies.one_of(
    strategies.just(good),
    strategies.binary(max_size=256),
    archives,
    strategies.integers(0, len(good) - 1).map(lambda length: good[:length]),
)
schemathesis.openapi.media_type("application/zip", bundles)


def ahead(hours=24):
    """An instant to come."""
    instant = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(hours=hours)
    return instant.strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def sensible(value, key=None):
    """The value of a field, with times that are to come, known zones, and one of what excludes another."""
    if key in ("deadline", "expires_at") and value is not None:
        return ahead()
    if key == "zone":
        return "Europe/Berlin"
    if key == "url":
        return "http://127.0.0.1:9/"
    if key == "maintenance" and isinstance(value, list):
        return [{"start": ahead(hours)} for hours in range(len(value))]
    if key == "frames" and isinstance(value, str):
        return "0"
    if key in ("price_per_hour", "budget") and value is not None:
        return 1_000_000
    if key == "name" and isinstance(value, str):
        return "".join(letter for letter in value if letter.isprintable()).strip() or "a name"
    if key == "capabilities" and isinstance(value, dict):
        return without(value, "calibration")
    if isinstance(value, dict):
        return {name: sensible(inner, name) for name, inner in value.items()}
    if isinstance(value, list):
        return [sensible(inner) for inner in value]
    return value


def without(body, *names):
    return {name: value for name, value in body.items() if name not in names}


def job(body):
    """A small job of the existing bundle. One that is held would never end, and neither would its events."""
    # An error target needs four samples.
    small = {"width": 8, "height": 8, "spp": 4}
    body = without(body, "renderer", "cache", "output", "ladders", "division", "within", "profile_frames", "limits", "hold")
    body = without(body, "denoise") if body.get("error_target") else body
    return {**body, "bundle": {"id": bundle_id}, "settings": small, "frames": "0-1", "project": "default", "samples": 16}


def what_if(body):
    change = {"more_nodes": {"node_id": things["nodes"][0], "count": 1}}
    return {"job_id": things["open_jobs"][0], "change": change}


def retention(body):
    by_project = body.get("project") and body.get("kind") in ("images", "profiles", "jobs")
    return {**without(body, "project"), **({"project": "default"} if by_project else {})}


def quota(body):
    kept = one_of("project", "token", "default")(body)
    return {**kept, "project": "default"} if "project" in kept else kept


def token(body):
    return {**without(body, "projects"), "role": body.get("role") or "viewer"}


def one_of(first, second, otherwise):
    """Of two fields the first that is there."""

    def kept(body):
        given = body.get(first) or otherwise
        return {**without(body, first, second), first: given}

    return kept


# What makes a body good, by method and path.
GOOD = {
    ("POST", "/v1/jobs"): job,
    ("POST", "/v1/jobs/check"): job,
    ("POST", "/v1/plans/what-if"): what_if,
    ("POST", "/v1/retention"): retention,
    ("POST", "/v1/tokens"): token,
    ("PATCH", "/v1/tokens/{id}"): lambda body: without(body, "projects"),
    ("POST", "/v1/quotas"): quota,
    # What was done is held against what is possible.
    ("PATCH", "/v1/leases/{id}"): lambda body: without(body, "pixels"),
    ("POST", "/v1/sessions"): one_of("code", "token", "a code that nobody has"),
    ("POST", "/v1/budget-forecasts"): lambda body: without(body, "date"),
    ("POST", "/v1/leases/{id}/result"): one_of("error", "result", {"message": "no"}),
}


def query(path, given):
    """Page tokens come from an answer, so none is made up. A timeline ends after it begins."""
    given = {name: value for name, value in given.items() if name != "page_token"}
    if path == "/v1/timeline":
        given = {name: value for name, value in given.items() if name not in ("from", "to")}
    return given


def header(name, value):
    """A key is of one request. Numbers are written without a point."""
    if name == "idempotency-key":
        return str(uuid.uuid4())
    return {"last-event-id": "0", "forelight-worker-protocol": "2", "if-match": "*"}.get(name, value)


@schemathesis.hook
def before_call(context, case, **kwargs):
    """No claim waits long, and good requests are good."""
    path, method = case.operation.path, case.operation.method.upper()
    if path == "/v1/leases" and isinstance(case.body, dict) and isinstance(case.body.get("wait_ms"), int):
        case.body = {**case.body, "wait_ms": min(case.body["wait_ms"], 500)}
    # The stream of an open job's events does not end.
    if path == "/v1/jobs/{id}/events" and case.path_parameters.get("id") not in things["jobs"]:
        case.path_parameters = {"id": things["jobs"][0]}
    if case.meta is None or not case.meta.generation.mode.is_positive:
        return
    if case.headers:
        case.headers = {name: header(name.lower(), value) for name, value in dict(case.headers).items()}
    if case.query:
        case.query = query(path, dict(case.query))
    if path == "/v1/bundles" and method == "POST":
        case.body = good
    elif path == "/v1/artifacts/{blake3}" and method == "PUT":
        case.path_parameters, case.body = {"blake3": HASH_OF_NOTHING}, b""
    elif isinstance(case.body, dict):
        case.body = GOOD.get((method, path), lambda body: body)(sensible(case.body))


@schemathesis.hook
def filter_case(context, case):
    """A client may send headers that the document does not name. The token of these requests must not be
    revoked or replaced: all requests after that would be refused. The farm's worker keeps its node."""
    is_own = (case.path_parameters or {}).get("id") in things["own_tokens"]
    of_own_token = case.operation.path.startswith("/v1/tokens/") and is_own
    if case.operation.path == "/v1/nodes/{id}" and case.operation.method.upper() in ("DELETE", "PATCH"):
        if (case.path_parameters or {}).get("id") == things["nodes"][0]:
            return False
    return "x-schemathesis-unknown-property" not in (case.headers or {}) and not of_own_token
