"""Reads a scene bundle (scene.json, OBJ and MTL) for other programs, independently of the one under test.

It reads OBJ geometry, frame 0 of the animation, a constant environment and quad lights. Anything else raises
an error, so that no comparison uses a partial scene. Lengths are metres, radiance is linear Rec. 709, indices
count from 0. Needs numpy; `read_image` and `write_image` also need OpenEXR.
"""

import json
import math
import shutil
import statistics
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy

GREY = (0.5, 0.5, 0.5)


class BundleError(Exception):
    """A bundle is malformed, or uses something unsupported."""


@dataclass
class Material:
    """One `newmtl`. Fields have the names of the keys in the file."""

    name: str
    illum: int = 1
    kd: tuple = GREY
    map_kd: Path | None = None
    ks: tuple | None = None
    ke: tuple = (0.0, 0.0, 0.0)
    ni: float = 1.5
    pr: float = 0.0
    tf: tuple = (1.0, 1.0, 1.0)
    d: float = 1.0

    @property
    def emits(self):
        return any(self.ke)

    def lambert(self):
        """Colour and texture of the surface as a diffuse one. Metals and glass are grey."""
        if self.illum in (3, 4, 7):
            return GREY, None
        return self.kd, self.map_kd


@dataclass
class Part:
    """The triangles of one object that share a material and have the same attributes."""

    object: str
    material: str
    positions: numpy.ndarray
    normals: numpy.ndarray | None
    uvs: numpy.ndarray | None
    triangles: numpy.ndarray


@dataclass
class Camera:
    origin: tuple
    target: tuple
    up: tuple
    fov_deg: float
    fov_axis: str

    def fov_x(self, width, height):
        """Opening angle along x in degrees, for square pixels."""
        if self.fov_axis == "x":
            return self.fov_deg
        return math.degrees(2 * math.atan(math.tan(math.radians(self.fov_deg) / 2) * width / height))


@dataclass
class Bundle:
    """Frame 0 of a bundle."""

    name: str
    camera: Camera
    environment: tuple | None
    materials: dict
    parts: list = field(default_factory=list)


def read(folder):
    """Frame 0 of the bundle in a folder."""
    folder = Path(folder)
    scene = json.loads((folder / "scene.json").read_text())
    if scene.get("version") != 1:
        raise BundleError(f"{folder}: version {scene.get('version')} is not 1")
    camera = dict(scene["camera"])
    if camera.get("aperture_radius"):
        raise BundleError(f"{folder}: a lens is not supported")
    moved = _first_frame(folder, scene)
    for (target, key), value in moved.items():
        if target == "camera":
            camera[key] = value
    bundle = Bundle(
        name=scene.get("name", folder.name),
        camera=Camera(*(camera[key] for key in ("origin", "target", "up", "fov_deg", "fov_axis"))),
        environment=_environment(folder, scene),
        materials={},
    )
    for name in scene["geometry"]:
        if not name.endswith(".obj"):
            raise BundleError(f"{folder}: geometry {name} is not OBJ")
        _read_obj(bundle, folder / name)
    for part in bundle.parts:
        _place(part, {key: value for (target, key), value in moved.items() if target == f"object:{part.object}"})
    for index, light in enumerate(scene.get("lights", [])):
        _add_quad(bundle, folder, index, light)
    return bundle


def without_environment(folder, destination):
    """Copies a bundle into a new folder without its environment, which some programs count as a bounce."""
    shutil.copytree(folder, destination, copy_function=shutil.copyfile)
    Path(destination).chmod(0o755)
    path = Path(destination) / "scene.json"
    scene = json.loads(path.read_text())
    scene.pop("environment", None)
    path.write_text(json.dumps(scene))
    return destination


def _first_frame(folder, scene):
    """Values of the tracks at frame 0, by (target, property)."""
    values = {}
    for track in scene.get("animation", {}).get("tracks", []):
        first = track["keys"][0]
        if first["frame"] != 0 and len(track["keys"]) > 1:
            raise BundleError(f"{folder}: a track of {track['target']} starts after frame 0")
        if track["target"].startswith("light:"):
            raise BundleError(f"{folder}: animated lights are not supported")
        values[track["target"], track["property"]] = first["value"]
    return values


def _environment(folder, scene):
    environment = scene.get("environment")
    if environment is None:
        return None
    if environment["type"] != "constant":
        raise BundleError(f"{folder}: an environment of type {environment['type']} is not supported")
    return tuple(environment["radiance"])


def _add_quad(bundle, folder, index, light):
    """A quad light is two black triangles that emit towards edge_u × edge_v."""
    if light["type"] != "quad":
        raise BundleError(f"{folder}: a light of type {light['type']} is not supported")
    corner, u, v = (numpy.array(light[key], float) for key in ("corner", "edge_u", "edge_v"))
    name = f"light {index}"
    bundle.materials[name] = Material(name, kd=(0.0, 0.0, 0.0), ke=tuple(light["radiance"]))
    bundle.parts.append(
        Part(
            object=name,
            material=name,
            positions=numpy.array([corner, corner + u, corner + u + v, corner + v]),
            normals=None,
            uvs=None,
            triangles=numpy.array([[0, 1, 2], [0, 2, 3]]),
        )
    )


def _place(part, transform):
    """Scales, turns and moves a part by its object's tracks."""
    if "scale" in transform:
        scale = numpy.array(transform["scale"], float)
        part.positions = part.positions * scale
        if part.normals is not None:
            part.normals = part.normals / scale
    if "rotation" in transform:
        x, y, z, w = numpy.array(transform["rotation"], float) / numpy.linalg.norm(transform["rotation"])
        turn = numpy.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        part.positions = part.positions @ turn.T
        if part.normals is not None:
            part.normals = part.normals @ turn.T
    if "translation" in transform:
        part.positions = part.positions + numpy.array(transform["translation"], float)


def _read_obj(bundle, path):
    vertices = {"v": [], "vt": [], "vn": []}
    # Corners as (position, texture coordinate, normal), by object, material and set of attributes.
    faces = {}
    object_name = material = ""
    for line in path.read_text().splitlines():
        key, _, rest = line.partition(" ")
        if key in vertices:
            vertices[key].append([float(word) for word in rest.split()[: 2 if key == "vt" else 3]])
        elif key == "f":
            corners = [_corner(word, vertices) for word in rest.split()]
            has = corners[0][1] is not None, corners[0][2] is not None
            list_of_faces = faces.setdefault((object_name, material, *has), [])
            list_of_faces.extend((corners[0], b, c) for b, c in zip(corners[1:], corners[2:]))
        elif key in ("o", "g"):
            object_name = rest.strip()
        elif key == "usemtl":
            material = rest.strip()
        elif key == "mtllib":
            _read_mtl(bundle, path.parent / rest.strip())
    positions, uvs, normals = (numpy.array(vertices[key], float) for key in ("v", "vt", "vn"))
    for (object_name, material, has_uvs, has_normals), triangles in faces.items():
        if material not in bundle.materials:
            raise BundleError(f"{path}: no material {material!r}")
        corners = [corner for triangle in triangles for corner in triangle]
        index = {corner: i for i, corner in enumerate(dict.fromkeys(corners))}
        unique = list(index)
        part = Part(
            object=object_name,
            material=material,
            positions=positions[[c[0] for c in unique]],
            normals=normals[[c[2] for c in unique]] if has_normals else None,
            uvs=uvs[[c[1] for c in unique]] if has_uvs else None,
            triangles=numpy.array([[index[corner] for corner in triangle] for triangle in triangles]),
        )
        part.triangles = part.triangles[_areas(part) > 0]
        if len(part.triangles):
            bundle.parts.append(part)


def _corner(word, vertices):
    """Position, texture coordinate and normal of a face's corner; negative indices count back from the
    last."""
    indices = (word.split("/") + ["", ""])[:3]
    lists = vertices["v"], vertices["vt"], vertices["vn"]
    return tuple(
        None if not index else int(index) - 1 if int(index) > 0 else len(known) + int(index)
        for index, known in zip(indices, lists)
    )


def _areas(part):
    a, b, c = (part.positions[part.triangles[:, k]] for k in range(3))
    return numpy.linalg.norm(numpy.cross(b - a, c - a), axis=1) / 2


def _read_mtl(bundle, path):
    material = None
    for line in path.read_text().splitlines():
        key, _, rest = line.strip().partition(" ")
        rest = rest.strip()
        if key == "newmtl":
            material = bundle.materials[rest] = Material(rest)
        elif key == "map_Kd":
            material.map_kd = path.parent / rest
        elif key in ("Kd", "Ks", "Ke", "Tf"):
            words = [float(word) for word in rest.split()]
            setattr(material, key.lower(), tuple(words * 3 if len(words) == 1 else words))
        elif key in ("Ni", "Pr", "d"):
            setattr(material, key.lower(), float(rest))
        elif key == "illum":
            material.illum = int(rest)


def outline(part):
    """The borders of a part's flat, simply connected pieces, each as one polygon of corners in order.

    Triangles that share an edge and a plane become one polygon. Some programs sample each polygon of a light
    by itself, or are exact only for rectangles.
    """
    positions, corner_of = numpy.unique(part.positions.round(9), axis=0, return_inverse=True)
    triangles = corner_of.reshape(-1)[part.triangles]
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    planes = numpy.cross(b - a, c - a)
    planes /= numpy.linalg.norm(planes, axis=1, keepdims=True)
    group = list(range(len(triangles)))

    def find(i):
        while group[i] != i:
            i = group[i]
        return i

    owner = {}
    for t, triangle in enumerate(triangles):
        for k in range(3):
            edge = int(triangle[k]), int(triangle[(k + 1) % 3])
            other = owner.get((edge[1], edge[0]))
            if other is not None and planes[t] @ planes[other] > 1 - 1e-6:
                group[find(t)] = find(other)
            owner[edge] = t
    polygons = []
    for root in sorted({find(t) for t in range(len(triangles))}):
        members = [t for t in range(len(triangles)) if find(t) == root]
        edges = {(int(triangles[t][k]), int(triangles[t][(k + 1) % 3])) for t in members for k in range(3)}
        border = {start: end for start, end in edges if (end, start) not in edges}
        ring = [min(border)]
        while border[ring[-1]] != ring[0]:
            ring.append(border[ring[-1]])
        if len(ring) != len(border):
            raise BundleError(f"{part.object}: a light with a hole is not supported")
        polygons.append(positions[ring])
    return polygons


def read_image(path):
    """Height × width × 3 linear values of an EXR file."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return numpy.stack([numpy.array(channels[name].pixels, numpy.float64) for name in "RGB"], axis=-1)


def write_image(path, image):
    """Writes height × width × 3 linear values as float EXR."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {"RGB": numpy.ascontiguousarray(image, numpy.float32)}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def compare(ours, theirs, mean_tolerance, block_tolerance, blocks=8):
    """Compares two images of one scene. Returns a list of problems, empty if they agree.

    Pixels within two of one that sees a light are left out. They are a hundred times as bright as the rest
    and say little about light transport. The distance is two, because noise decides whether a pixel with a
    sliver of a light sees it. The means of the rest may differ by `mean_tolerance`, relative. The root mean
    square difference of `blocks` × `blocks` parts may be `block_tolerance` of the mean; it finds light in the
    wrong place.
    """
    if ours.shape != theirs.shape:
        return [f"sizes {ours.shape} and {theirs.shape}"]
    brightest = numpy.maximum(ours, theirs).max(axis=2)
    # NaN fails every comparison, so test it first.
    lights = brightest > 40 * numpy.median(theirs)
    padded = numpy.pad(lights, 2)
    height, width = lights.shape
    seen = ~numpy.any([padded[y : y + height, x : x + width] for y in range(5) for x in range(5)], axis=0)
    mean = theirs[seen].mean()
    difference = ours[seen].mean() / mean - 1
    kept = numpy.where(seen[..., None], ours - theirs, 0)
    rows = [[part.mean() for part in numpy.array_split(row, blocks, axis=1)] for row in numpy.array_split(kept, blocks)]
    root = float(numpy.sqrt(numpy.mean(numpy.square(rows)))) / mean
    print(f"  {seen.mean():.0%} of the pixels: mean {ours[seen].mean():.5f} against {mean:.5f} ({difference:+.2%}), blocks {root:.2%}")
    problems = []
    if not seen.mean() > 0.5:
        problems.append("half of the pixels see lights")
    if not abs(difference) <= mean_tolerance:
        problems.append(f"the means differ by {difference:+.2%}; {mean_tolerance:.1%} is allowed")
    if not root <= block_tolerance:
        problems.append(f"the means of blocks differ by {root:.2%} (RMS); {block_tolerance:.1%} is allowed")
    return problems


def compare_means(ours, theirs, tolerance, largest_error):
    """Compares the means of two sets of images of one scene, each with its own seed. Returns a list of
    problems.

    The means may differ by `tolerance`, relative, plus three standard errors of the difference. These come
    from the means of the single images and must not exceed `largest_error`.
    """
    sets = [[float(image.mean()) for image in images] for images in (ours, theirs)]
    mean, expected = map(statistics.fmean, sets)
    error = math.sqrt(sum(statistics.variance(means) / len(means) for means in sets)) / expected
    difference = mean / expected - 1
    print(f"  mean {mean:.5f} against {expected:.5f} ({difference:+.3%} ± {error:.3%})")
    problems = []
    if not error <= largest_error:
        problems.append(f"the standard error is {error:.3%}; {largest_error:.3%} is allowed")
    if not abs(difference) <= tolerance + 3 * error:
        problems.append(f"the means differ by {difference:+.3%}; {tolerance:.1%} and three standard errors are allowed")
    return problems


def peers(measured, reference):
    """Arguments of `forelight bench images`, from a file with one JSON object per rendered image: each image
    with its median CPU seconds and the program's converged image as reference."""
    seconds = {}
    for line in Path(measured).read_text().splitlines():
        facts = json.loads(line)
        seconds.setdefault((facts["name"], facts["image"]), []).append(facts["cpu_seconds"])
    for (name, image), values in seconds.items():
        yield "--peer"
        yield f"{name}:{image}:{statistics.median(values):.6f}:{reference}"


def main():
    """`compare OURS THEIRS MEAN_TOLERANCE BLOCK_TOLERANCE`, `compare-means TOLERANCE LARGEST_ERROR OURS…
    THEIRS…` with equal numbers of both, `without-environment FROM TO`, `peers MEASURED REFERENCE`."""
    command, first, second, *rest = sys.argv[1:]
    if command == "without-environment":
        without_environment(first, second)
        return
    if command == "peers":
        print("\n".join(peers(first, second)))
        return
    if command == "compare":
        problems = compare(read_image(first), read_image(second), *map(float, rest))
    elif command == "compare-means":
        images = [read_image(path) for path in rest]
        half = len(images) // 2
        problems = compare_means(images[:half], images[half:], float(first), float(second))
    else:
        raise SystemExit(f"unknown command {command}")
    for problem in problems:
        print(f"  WRONG: {problem}")
    if problems:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
