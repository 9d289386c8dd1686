"""Renders a bundle with Mitsuba 3's path integrator: EXR images and their CPU times.

    mitsuba_peer.py BUNDLE --out FOLDER --size 512 --spp 4,16,64 [--materials lambert] [--depth 3]

`--materials full` uses Mitsuba's own BSDF for each material, `--materials format` the bundle format's
plastics and rough metals.

Prints one line of JSON per image: name, image, spp, cpu_seconds (user and system), wall_seconds. Times
exclude loading the scene and compiling kernels.
"""

import argparse
import itertools
import json
import resource
import tempfile
import time
from pathlib import Path

import numpy

import bundle as bundles

# Samples per pixel and call, to bound the memory of the wavefront.
SAMPLES_AT_ONCE = 16


def write_ply(path, part):
    """A part as binary PLY. Texture coordinates have v down, like Mitsuba's bitmaps."""
    columns, names = [part.positions], ["x", "y", "z"]
    if part.normals is not None:
        columns.append(part.normals)
        names += ["nx", "ny", "nz"]
    if part.uvs is not None:
        columns.append(numpy.column_stack([part.uvs[:, 0], 1 - part.uvs[:, 1]]))
        names += ["u", "v"]
    faces = numpy.empty(len(part.triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, part.triangles
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(part.positions)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    data = "\n".join(header).encode() + numpy.column_stack(columns).astype("<f4").tobytes() + faces.tobytes()
    Path(path).write_bytes(data)


def rgb(values):
    return {"type": "rgb", "value": list(values)}


def colour(kd, texture):
    if texture is None:
        return rgb(kd)
    return {"type": "bitmap", "filename": str(texture), "wrap_mode": "repeat", "filter_type": "bilinear"}


def bsdf(material, materials):
    """The material in Mitsuba's terms."""
    if materials == "lambert":
        return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": colour(*material.lambert())}}
    alpha = material.pr**2
    if materials == "format" and alpha >= 1e-3:
        if material.illum == 3:
            return {"type": "twosided", "bsdf": {"type": "format_surface", "alpha": alpha, "f0": rgb(material.ks)}}
        if material.illum == 2 and material.ks and any(material.ks):
            base = colour(material.kd, material.map_kd)
            return {"type": "twosided", "bsdf": {"type": "format_surface", "alpha": alpha, "ior": material.ni, "base": base}}
    rough = {"distribution": "ggx", "alpha": max(alpha, 1e-4)}
    index = {"int_ior": material.ni, "ext_ior": 1.0}
    if material.illum == 3:
        # A dielectric without absorption and with the same reflectance at normal incidence.
        roots = numpy.sqrt(numpy.clip(material.ks, 0.0, 0.9999))
        complex_index = {"eta": rgb((1 + roots) / (1 - roots)), "k": rgb((0.0, 0.0, 0.0))}
        smooth = alpha < 1e-3
        metal = {"type": "conductor"} if smooth else {"type": "roughconductor", **rough}
        metal |= complex_index
        return {"type": "twosided", "bsdf": metal}
    if material.illum == 4:
        return {"type": "thindielectric", **index, "specular_transmittance": rgb(material.tf)}
    if material.illum == 7:
        return {"type": "dielectric", **index, "specular_transmittance": rgb(material.tf)}
    diffuse = colour(material.kd, material.map_kd)
    if material.illum == 2 and material.ks and any(material.ks):
        coat = {**index, "diffuse_reflectance": diffuse, "nonlinear": False}
        smooth = alpha < 1e-3
        plastic = {"type": "plastic", **coat} if smooth else {"type": "roughplastic", **coat, **rough}
        return {"type": "twosided", "bsdf": plastic}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": diffuse}}


def load(mitsuba, bundle, size, materials, depth, sampler):
    """The bundle as a Mitsuba scene, with its own camera and a square image."""
    camera = bundle.camera
    transform = mitsuba.ScalarTransform4f().look_at(camera.origin, camera.target, camera.up)
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth, "rr_depth": 8},
        "sensor": {
            "type": "perspective",
            "fov": camera.fov_x(size, size),
            "fov_axis": "x",
            "to_world": transform,
            "near_clip": 1e-3,
            "far_clip": 1e5,
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
            "sampler": {"type": sampler, "sample_count": SAMPLES_AT_ONCE},
        },
    }
    if bundle.environment is not None:
        scene["environment"] = {"type": "constant", "radiance": rgb(bundle.environment)}
    with tempfile.TemporaryDirectory() as folder:
        for index, part in enumerate(bundle.parts):
            path = f"{folder}/{index}.ply"
            write_ply(path, part)
            material = bundle.materials[part.material]
            shape = {"type": "ply", "filename": path, "bsdf": bsdf(material, materials)}
            shape["face_normals"] = part.normals is None
            if material.emits:
                shape["emitter"] = {"type": "area", "radiance": rgb(material.ke)}
            scene[f"shape {index}"] = shape
        return mitsuba.load_dict(scene)


def render(mitsuba, scene, spp, seed):
    """The image, its CPU seconds and its wall seconds."""
    started, used = time.monotonic(), resource.getrusage(resource.RUSAGE_SELF)
    total, done = None, 0
    while done < spp:
        now = min(SAMPLES_AT_ONCE, spp - done)
        # The sampler stratifies the samples of one call.
        image = numpy.array(mitsuba.render(scene, spp=now, seed=seed * 100_003 + done), numpy.float64) * now
        total = image if total is None else total + image
        done += now
    after = resource.getrusage(resource.RUSAGE_SELF)
    cpu = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
    return total / spp, cpu, time.monotonic() - started


def choose_variant(mitsuba, wanted):
    """The fastest variant that runs here. The vectorised one needs LLVM."""
    if wanted:
        mitsuba.set_variant(wanted)
        return wanted
    try:
        mitsuba.set_variant("llvm_ad_rgb")
        import drjit

        drjit.eval(mitsuba.Float(1) + mitsuba.Float(2))
        return "llvm_ad_rgb"
    except Exception:
        mitsuba.set_variant("scalar_rgb")
        return "scalar_rgb"


def set_up_materials(mitsuba, bundle, variant):
    """Registers the bundle format's surfaces with Mitsuba."""
    import mitsuba_materials

    mitsuba.set_variant("scalar_rgb")
    internal = {ior: mitsuba_materials.internal_diffuse(mitsuba, ior) for ior in {m.ni for m in bundle.materials.values()}}
    mitsuba.set_variant(variant)
    mitsuba_materials.register(mitsuba, internal)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle")
    parser.add_argument("--out", required=True)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--spp", default="16", help="samples per pixel, one image each, separated by commas")
    parser.add_argument("--repeats", type=int, default=1, help="render each image this many times, to measure its time")
    parser.add_argument("--batches", type=int, default=1, help="number of images for each number of samples, with seeds from --seed on")
    parser.add_argument("--materials", choices=["lambert", "full", "format"], default="lambert")
    parser.add_argument("--depth", type=int, default=3, help="3: one bounce")
    parser.add_argument("--sampler", default="multijitter")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--variant", default=None)
    arguments = parser.parse_args()
    import mitsuba

    variant = choose_variant(mitsuba, arguments.variant)
    bundle = bundles.read(arguments.bundle)
    if arguments.materials == "format":
        set_up_materials(mitsuba, bundle, variant)
    scene = load(mitsuba, bundle, arguments.size, arguments.materials, arguments.depth, arguments.sampler)
    ladder = [int(spp) for spp in arguments.spp.split(",")]
    if variant != "scalar_rgb":
        # Compile the kernels, one for each number of samples per call.
        for spp in sorted({min(spp, SAMPLES_AT_ONCE) for spp in ladder}):
            render(mitsuba, scene, spp, 0)
    for repeat, batch, spp in itertools.product(range(arguments.repeats), range(arguments.batches), ladder):
        image, cpu, wall = render(mitsuba, scene, spp, arguments.seed + batch)
        suffix = f"-{batch + 1}" if arguments.batches > 1 else ""
        path = Path(arguments.out) / f"mitsuba-{spp}{suffix}.exr"
        if repeat == 0:
            bundles.write_image(path, image)
        facts = {"name": f"mitsuba {spp} spp{suffix}", "image": str(path), "spp": spp, "variant": variant}
        print(json.dumps({**facts, "cpu_seconds": cpu, "wall_seconds": wall}), flush=True)


if __name__ == "__main__":
    main()
