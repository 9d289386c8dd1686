"""Writes bundles as glTF files, for other programs to compress, and compares triangles and pictures.

    gltf_peer.py export BUNDLE OUT.glb            writes frame 0, and lets the first object move for a second
    gltf_peer.py compare NAME THEIRS OURS BITS    compares triangles, as `--example triangles` prints them,
                                                  within a grid of so many bits; THEIRS may be a bundle
    gltf_peer.py visible NAME PLAIN OURS          compares the materials in two EXR files, by Cryptomatte

Needs numpy, scipy and OpenEXR.
"""

import json
import math
import struct
import sys
from pathlib import Path

import numpy
from scipy.spatial import cKDTree

import bundle

FLOAT, UNSIGNED = 5126, 5125


class Writer:
    """A binary glTF file in the making."""

    def __init__(self):
        self.binary = bytearray()
        self.document = {
            "asset": {"version": "2.0", "generator": "forelight tests"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            **{key: [] for key in ("nodes", "meshes", "materials", "accessors", "bufferViews")},
        }

    def add(self, kind, thing):
        self.document.setdefault(kind, []).append(thing)
        return len(self.document[kind]) - 1

    def view(self, data):
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        offset = len(self.binary)
        self.binary.extend(data)
        return self.add("bufferViews", {"buffer": 0, "byteOffset": offset, "byteLength": len(data)})

    def accessor(self, array, kind, bounds=False):
        integers = numpy.issubdtype(array.dtype, numpy.integer)
        array = numpy.ascontiguousarray(array, numpy.uint32 if integers else numpy.float32)
        accessor = {
            "bufferView": self.view(array.tobytes()),
            "componentType": UNSIGNED if integers else FLOAT,
            "count": len(array),
            "type": kind,
        }
        if bounds:
            rows = array.reshape(len(array), -1)
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        return self.add("accessors", accessor)

    def write(self, path):
        self.document["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.document).encode()
        text += b" " * (-len(text) % 4)
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(self.binary), 0x004E4942) + self.binary
        Path(path).write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def export(folder, out):
    """Writes frame 0 of a bundle. Only shape and base colour are kept of its materials."""
    scene = bundle.read(folder)
    writer = Writer()
    materials = {name: writer.add("materials", _material(writer, m)) for name, m in scene.materials.items()}
    objects = {}
    for part in scene.parts:
        attributes = {"POSITION": writer.accessor(part.positions, "VEC3", bounds=True)}
        if part.normals is not None:
            normals = part.normals / numpy.linalg.norm(part.normals, axis=1, keepdims=True)
            attributes["NORMAL"] = writer.accessor(normals, "VEC3")
        if part.uvs is not None:
            # In glTF, v points down.
            attributes["TEXCOORD_0"] = writer.accessor(part.uvs * (1, -1) + (0, 1), "VEC2")
        indices = writer.accessor(part.triangles.reshape(-1), "SCALAR")
        primitive = {"attributes": attributes, "indices": indices, "material": materials[part.material]}
        objects.setdefault(part.object, []).append(primitive)
    for name, primitives in objects.items():
        mesh = writer.add("meshes", {"primitives": primitives})
        writer.document["scenes"][0]["nodes"].append(writer.add("nodes", {"name": name, "mesh": mesh}))
    _camera(writer, scene.camera)
    _motion(writer)
    writer.write(out)


def _material(writer, material):
    colour = {"baseColorFactor": [*material.kd, 1.0], "metallicFactor": 0.0, "roughnessFactor": material.pr}
    if material.map_kd:
        image = {"bufferView": writer.view(material.map_kd.read_bytes()), "mimeType": "image/png"}
        texture = writer.add("textures", {"source": writer.add("images", image)})
        colour["baseColorTexture"] = {"index": texture}
    return {"name": material.name, "pbrMetallicRoughness": colour}


def _camera(writer, camera):
    origin, target, up = (numpy.array(v, float) for v in (camera.origin, camera.target, camera.up))
    back = (origin - target) / numpy.linalg.norm(origin - target)
    right = numpy.cross(up, back)
    right /= numpy.linalg.norm(right)
    columns = [*right, 0, *numpy.cross(back, right), 0, *back, 0, *origin, 1]
    yfov = 2 * math.atan(math.tan(math.radians(camera.fov_x(16, 9)) / 2) * 9 / 16)
    lens = {"yfov": yfov, "aspectRatio": 16 / 9, "znear": 0.01}
    index = writer.add("cameras", {"type": "perspective", "perspective": lens})
    node = writer.add("nodes", {"name": "camera", "camera": index, "matrix": [float(c) for c in columns]})
    writer.document["scenes"][0]["nodes"].append(node)


def _motion(writer):
    """The first object turns, moves and grows, so that the filters of animations are used."""
    times = writer.accessor(numpy.linspace(0, 1, 9), "SCALAR", bounds=True)
    turned = numpy.linspace(0, 0.4, 9)
    axis = numpy.array((0.36, 0.48, 0.8))
    rotations = [(*(axis * math.sin(angle / 2)), math.cos(angle / 2)) for angle in turned]
    tracks = {
        "rotation": numpy.array(rotations),
        "translation": numpy.outer(turned, (1.0, -0.7, 0.123)),
        "scale": 1 + numpy.outer(turned, (0.5, 0.25, 1.0)),
    }
    samplers, channels = [], []
    for path, values in tracks.items():
        kind = "VEC4" if path == "rotation" else "VEC3"
        channels.append({"sampler": len(samplers), "target": {"node": 0, "path": path}})
        samplers.append({"input": times, "output": writer.accessor(values, kind)})
    writer.add("animations", {"samplers": samplers, "channels": channels})


def _printed(path):
    """Triangles by (object, material): 9 coordinates, 9 components of normals and 6 texture coordinates."""
    groups = {}
    for line in Path(path).read_text().splitlines():
        name, material, *numbers = line.split("\t")
        groups.setdefault((name, material), []).append([float(number) for number in numbers])
    return {key: numpy.array(rows) for key, rows in groups.items()}


def _bundled(folder):
    groups = {}
    for part in bundle.read(folder).parts:
        zeros = numpy.zeros_like(part.positions)
        normals = zeros if part.normals is None else part.normals
        normals = normals / numpy.maximum(numpy.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        uvs = zeros[:, :2] if part.uvs is None else part.uvs
        columns = [a[part.triangles].reshape(len(part.triangles), -1) for a in (part.positions, normals, uvs)]
        groups.setdefault((part.object, part.material), []).append(numpy.hstack(columns))
    return {key: numpy.vstack(rows) for key, rows in groups.items()}


def _by_material(groups):
    joined = {}
    for (_, material), rows in groups.items():
        joined.setdefault(material, []).append(rows)
    return {material: numpy.vstack(rows) for material, rows in joined.items()}


def compare(name, theirs, ours, bits):
    """Every triangle of one side must be near one of the other, in either direction. Prints the distances."""
    theirs = _bundled(theirs) if Path(theirs).is_dir() else _printed(theirs)
    ours = _printed(ours)
    if theirs.keys() != ours.keys():
        # Some programs put meshes into unnamed nodes, for what undoes the quantisation.
        theirs, ours = _by_material(theirs), _by_material(ours)
    if theirs.keys() != ours.keys():
        sys.exit(f"{name}: materials differ: {sorted(theirs.keys() ^ ours.keys())}")
    everything = numpy.vstack(list(theirs.values()))
    extents = [numpy.ptp(everything[:, :9]), 2.0, max(numpy.ptp(everything[:, 18:]), 1.0)]
    # Normals have at least 7 good bits, and texture coordinates 12, whatever the positions have.
    steps = [extents[0] / 2**bits, extents[1] / 2 ** min(bits, 6), extents[2] / 2 ** min(bits, 11)]
    weights = numpy.repeat([1 / step for step in steps], [9, 9, 6])
    worst, lost, missing = 0.0, 0, 0
    for key in theirs:
        far = _distances(theirs[key] * weights, ours[key] * weights)
        back = _distances(ours[key] * weights, theirs[key] * weights)
        # Triangles that are thinner than a step may vanish.
        gone = (far > 1) & (_heights(theirs[key][:, :9]) < 2 * steps[0])
        worst = max(worst, far[~gone].max(initial=0), back.max(initial=0))
        missing += int((far[~gone] > 1).sum() + (back > 1).sum())
        lost += int(gone.sum())
    count, found = (sum(map(len, side.values())) for side in (theirs, ours))
    print(f"  {name}: {count} triangles, {lost} too thin and lost, others at most {worst:.2f} steps apart")
    if missing or found + lost < count or found > count:
        sys.exit(f"{name}: {missing} triangles have no counterpart within one step; {found} of {count} exist")


def _distances(source, target):
    """For each triangle the largest difference of any number to the nearest triangle of the others."""
    return cKDTree(_turned(target)).query(source, p=numpy.inf)[0]


def _heights(corners):
    """The least height of each triangle."""
    a, b, c = (corners[:, k : k + 3] for k in (0, 3, 6))
    double = numpy.linalg.norm(numpy.cross(b - a, c - a), axis=1)
    edges = numpy.stack([numpy.linalg.norm(u - v, axis=1) for u, v in ((a, b), (b, c), (c, a))])
    return double / edges.max(axis=0)


def _turned(triangles):
    """The triangles three times, with each corner as the first."""
    turned = []
    for first in range(3):
        order = [(first + k) % 3 for k in range(3)]
        blocks = (triangles[:, :9].reshape(-1, 3, 3), triangles[:, 9:18].reshape(-1, 3, 3))
        blocks += (triangles[:, 18:].reshape(-1, 3, 2),)
        turned.append(numpy.hstack([block[:, order].reshape(len(triangles), -1) for block in blocks]))
    return numpy.vstack(turned)


def visible(name, plain, ours):
    """Nearly every pixel must show the same material. At edges the quantisation decides."""
    plain, ours = _materials(plain), _materials(ours)
    different = (plain != ours).mean()
    shown = len(numpy.unique(ours))
    print(f"  {name}: {shown} materials in the picture, {different:.2%} of the pixels differ")
    if different > 0.02 or shown < 5:
        sys.exit(f"{name}: the picture shows other materials")


def _materials(path):
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        return numpy.array(file.channels()["CryptoMaterial00.R"].pixels).view(numpy.uint32)


def main():
    match sys.argv[1:]:
        case ["export", folder, out]:
            export(folder, out)
        case ["compare", name, theirs, ours, bits]:
            compare(name, theirs, ours, int(bits))
        case ["visible", name, plain, ours]:
            visible(name, plain, ours)
        case _:
            sys.exit(__doc__)


main()
