"""Writes `src/forelight/rest`, the client of every route, from the service's `openapi.yaml`.

hatchling runs this when it builds the package. `python generate.py` does the same by hand.
"""

import copy
import json
import shutil
import subprocess
import sys
import tempfile
from datetime import datetime
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from ruamel.yaml import YAML

HERE = Path(__file__).resolve().parent
DOCUMENT = HERE.parent.parent / "openapi.yaml"
PACKAGE = HERE / "src" / "forelight" / "rest"

# Media types whose bodies are passed on as they are.
FILES = [
    "application/zip",
    "application/x-blender",
    "image/png",
    "image/x-exr",
    "image/svg+xml",
    "video/mp4",
    "application/yaml",
]


def with_named_variants(document):
    """Gives a name to each object inside a variant of a union. The generator names them twice otherwise."""
    document = copy.deepcopy(document)
    schemas = document["components"]["schemas"]
    for name, schema in list(schemas.items()):
        for variant in schema.get("oneOf", []):
            for key, inner in variant.get("properties", {}).items():
                if inner.get("type") == "object":
                    own = name + key.title().replace("_", "")
                    schemas[own] = inner
                    variant["properties"][key] = {"$ref": f"#/components/schemas/{own}"}
    return document


def without_streams(document):
    """Leaves out streams of events. The generator does not know them; `Farm.follow` reads them."""
    document = copy.deepcopy(document)
    for path, routes in list(document["paths"].items()):
        if "text/event-stream" in routes.get("get", {}).get("responses", {}).get("200", {}).get("content", {}):
            del document["paths"][path]
    return document


def generate():
    if not DOCUMENT.exists():
        # A source distribution has the generated files, and not the document.
        if PACKAGE.exists():
            return
        raise SystemExit(f"{DOCUMENT} does not exist: build from a checkout of the repository")
    with tempfile.TemporaryDirectory() as folder:
        document, options = Path(folder, "openapi.json"), Path(folder, "options.json")
        read = with_named_variants(without_streams(YAML(typ="safe").load(DOCUMENT)))
        document.write_text(json.dumps(read, default=datetime.isoformat))
        overrides = {media_type: "application/octet-stream" for media_type in FILES}
        options.write_text(json.dumps({"content_type_overrides": overrides, "post_hooks": []}))
        made = Path(folder, "rest")
        subprocess.run(
            [
                *(sys.executable, "-m", "openapi_python_client", "generate", "--meta", "none"),
                *("--path", document, "--config", options, "--output-path", made, "--fail-on-warning"),
            ],
            check=True,
        )
        shutil.rmtree(PACKAGE, ignore_errors=True)
        shutil.copytree(made, PACKAGE)


class GenerateHook(BuildHookInterface):
    def initialize(self, version, build_data):
        generate()


if __name__ == "__main__":
    generate()
