"""Tells Schemathesis how bundles are made, and which requests are no tests."""

import io
import os
import pathlib
import zipfile

import schemathesis
from hypothesis import strategies


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


@schemathesis.hook
def map_body(context, body):
    """Half of the jobs use the existing bundle and are small, so that some of them finish. No claim waits
    long."""
    if not isinstance(body, dict):
        return body
    path = context.operation.path
    if path in ("/v1/jobs", "/v1/jobs/check") and len(str(body)) % 2 == 0:
        small = {"width": 8, "height": 8, "spp": 1}
        changes = {"bundle": {"id": os.environ["FORELIGHT_EXAMPLE_BUNDLE"]}, "settings": small, "frames": "0-1", "deadline": None}
        return {**body, **changes}
    if path == "/v1/leases" and isinstance(body.get("wait_ms"), int):
        return {**body, "wait_ms": min(body["wait_ms"], 500)}
    return body


@schemathesis.hook
def filter_case(context, case):
    """A client may send headers that the document does not name. The token of these requests must not be
    revoked or replaced: all requests after that would be refused."""
    is_own = (case.path_parameters or {}).get("id") == os.environ["FORELIGHT_OWN_TOKEN"]
    of_own_token = case.operation.path.startswith("/v1/tokens/") and is_own
    return "x-schemathesis-unknown-property" not in (case.headers or {}) and not of_own_token
