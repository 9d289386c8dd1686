"""Renders a bundle with Radiance's rpict and its ambient cache: EXR images and their CPU times.

    radiance_peer.py BUNDLE --out FOLDER --size 512 --rung 'NAME: -aa .15 -ad 512 -as 128 -ar 128'…

All surfaces are diffuse (`plastic` without gloss), area lights are `light` polygons of the same radiance, and
no value is converted to lumens. Prints one line of JSON per image: name, image, options, cpu_seconds (user
and system of rpict, without loading the scene).

A rung may begin with `xN`: the image is rendered N times as large in each direction and averaged, as Radiance
does to smooth edges.
"""

import argparse
import json
import os
import resource
import subprocess
import tempfile
from pathlib import Path

import numpy
from PIL import Image

import bundle as bundles

# Options of all images: one bounce, one jittered ray per pixel, exact direct light.
SHARED = "-ab 1 -av 0 0 0 -aw 0 -ps 1 -pj 1 -dj 1 -dt 0 -dc 1 -lw 1e-6 -lr 6".split()


def installed():
    """Folders of the programs and of their library, in the Python package."""
    import pyradiance

    root = Path(pyradiance.__file__).parent
    return root / "bin", root / "lib"


def run(program, *arguments, **options):
    """Runs one of Radiance's programs. Returns its CPU seconds and its output."""
    programs, library = installed()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "RAYPATH": f".:{library}"}
    done = subprocess.run([programs / program, *map(str, arguments)], env=environment, capture_output=True, **options)
    if done.returncode:
        raise RuntimeError(f"{program}: {done.stderr.decode(errors='replace').strip()}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def write_picture(path, texture):
    """Writes a texture as a flat Radiance picture in linear light. Returns width and height over the shorter
    side."""
    encoded = numpy.asarray(Image.open(texture).convert("RGB"), numpy.float64) / 255
    linear = numpy.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    mantissa, exponent = numpy.frexp(linear.max(axis=2))
    scale = numpy.where(mantissa > 0, 256 / numpy.ldexp(1.0, exponent), 0)
    pixels = numpy.dstack([numpy.floor(linear * scale[..., None]), numpy.where(mantissa > 0, exponent + 128, 0)])
    height, width = linear.shape[:2]
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n"
    Path(path).write_bytes(header.encode() + pixels.astype(numpy.uint8).tobytes())
    shorter = min(width, height)
    return width / shorter, height / shorter


def numbers(values):
    return " ".join(f"{value:.9g}" for value in values)


def surface(polygon):
    """Type and arguments of a light's surface; the identifier goes between them. rpict samples rectangles and
    discs exactly, and other polygons as if they were squares."""
    centre = polygon.mean(axis=0)
    spokes = polygon - centre
    radii = numpy.linalg.norm(spokes, axis=1)
    if len(polygon) < 8 or numpy.ptp(radii) > 1e-3 * radii.max():
        return "polygon", f"{polygon.size} {numbers(polygon.ravel())}"
    # A disc of the same area.
    normal = numpy.cross(spokes, numpy.roll(spokes, -1, axis=0)).sum(axis=0) / 2
    area = numpy.linalg.norm(normal)
    return "ring", f"8 {numbers(centre)} {numbers(normal / area)} 0 {numpy.sqrt(area / numpy.pi):.9g}"


def convert(bundle, folder):
    """Writes the bundle as an octree of one triangle mesh, with lights as polygons. Returns the octree's
    path."""
    folder = Path(folder)
    names = {name: f"m{index}" for index, name in enumerate(bundle.materials)}
    pictures, materials, lights, mesh = {}, [], [], ["# a bundle"]
    for name, material in bundle.materials.items():
        kd, texture = material.lambert()
        if material.emits:
            lights.append(f"void light {names[name]}\n0\n0\n3 {numbers(material.ke)}\n")
            continue
        modifier = "void"
        if texture is not None:
            if texture not in pictures:
                picture = f"t{len(pictures)}.hdr"
                pictures[texture] = picture, write_picture(folder / picture, texture)
            picture, (wide, high) = pictures[texture]
            modifier, kd = f"{names[name]}_texture", (1, 1, 1)
            place = f"frac(Lu)*{wide:.9g} frac(Lv)*{high:.9g}"
            materials.append(f"void colorpict {modifier}\n7 red green blue {picture} . {place}\n0\n0\n")
        materials.append(f"{modifier} plastic {names[name]}\n0\n0\n5 {numbers(kd)} 0 0\n")
    counts = numpy.zeros(3, int)
    for part in bundle.parts:
        if bundle.materials[part.material].emits:
            for index, polygon in enumerate(bundles.outline(part)):
                kind, arguments = surface(polygon)
                lights.append(f"{names[part.material]} {kind} l{len(lights)}_{index}\n0\n0\n{arguments}\n")
            continue
        mesh.append(f"usemtl {names[part.material]}")
        here = counts + 1
        for key, rows in (("v", part.positions), ("vt", part.uvs), ("vn", part.normals)):
            if rows is not None:
                mesh += [f"{key} {numbers(row)}" for row in rows]
        for triangle in part.triangles:
            corners = []
            for corner in triangle:
                uv = "" if part.uvs is None else str(here[1] + corner)
                normal = "" if part.normals is None else f"/{here[2] + corner}"
                corners.append(f"{here[0] + corner}/{uv}{normal}")
            mesh.append("f " + " ".join(corners))
        for k, rows in enumerate((part.positions, part.uvs, part.normals)):
            counts[k] += 0 if rows is None else len(rows)
    if bundle.environment is not None:
        lights.append(f"void glow sky\n0\n0\n4 {numbers(bundle.environment)} 0\n\nsky source environment\n0\n0\n4 0 1 0 360\n")
    (folder / "materials.rad").write_text("\n".join(materials))
    (folder / "mesh.obj").write_text("\n".join(mesh) + "\n")
    (folder / "scene.rad").write_text("\n".join(lights) + "\nvoid mesh everything\n1 mesh.rtm\n0\n0\n")
    run("obj2mesh", "-a", "materials.rad", "mesh.obj", "mesh.rtm", cwd=folder)
    octree = folder / "scene.oct"
    octree.write_bytes(run("oconv", "-r", "8192", "scene.rad", cwd=folder)[1])
    return octree


def view(camera, size):
    """rpict's arguments for a square image."""
    direction = numpy.array(camera.target, float) - numpy.array(camera.origin, float)
    opening = f"{camera.fov_x(size, size):.9g}"
    arguments = ["-vtv", "-vp", *camera.origin, "-vd", *direction, "-vu", *camera.up, "-vh", opening, "-vv", opening]
    return [str(argument) for argument in arguments]


def picture(folder, camera, size, factor, options):
    """CPU seconds of rpict, and the image, rendered `factor` times as large."""
    side = size * factor
    arguments = ["-x", side, "-y", side, *view(camera, size), *SHARED, *options, "scene.oct"]
    cpu, picture = run("rpict", *arguments, cwd=folder)
    raw = run("pvalue", "-h", "-H", "-df", input=picture)[1]
    image = numpy.frombuffer(raw, numpy.float32).reshape(side, side, 3).astype(numpy.float64)
    return cpu, image.reshape(size, factor, size, factor, 3).mean(axis=(1, 3))


def parse_rung(text):
    """Name, enlargement and options of `NAME: [xN] OPTIONS`."""
    name, _, rest = text.partition(":")
    options = rest.split()
    factor = 1
    if options and options[0].startswith("x"):
        factor = int(options.pop(0)[1:])
    return name.strip(), factor, options


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle")
    parser.add_argument("--out", required=True)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--rung", action="append", default=[], metavar="NAME: [xN] OPTIONS")
    parser.add_argument("--repeats", type=int, default=1)
    arguments = parser.parse_args()
    bundle = bundles.read(arguments.bundle)
    with tempfile.TemporaryDirectory() as folder:
        convert(bundle, folder)
        load = [picture(folder, bundle.camera, 1, 1, ["-ab", "0"])[0] for _ in range(3)]
        for repeat in range(arguments.repeats):
            for name, factor, options in map(parse_rung, arguments.rung):
                cpu, image = picture(folder, bundle.camera, arguments.size, factor, options)
                path = Path(arguments.out) / f"radiance-{name.replace(' ', '-')}.exr"
                if repeat == 0:
                    bundles.write_image(path, image)
                facts = {"name": f"radiance {name}", "image": str(path), "options": [f"x{factor}", *options]}
                print(json.dumps({**facts, "cpu_seconds": max(cpu - sorted(load)[1], 0.0), "load_seconds": sorted(load)[1]}), flush=True)


if __name__ == "__main__":
    main()
