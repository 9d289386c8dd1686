"""Writes frame 0 of a bundle as a scene of Radiance: a .rif file, materials, lights, and a mesh for each object.

Radiance calls all triangles of meshes by one name, so each object has its own aliases of its materials.

    radiance_scenes.py BUNDLE FOLDER [--size 256]

Materials keep what costs rays: glass, mirrors, metals and gloss. Prints the path of the .rif file.
"""

import argparse
import re
from pathlib import Path

import numpy

import bundle as bundles
from radiance_peer import numbers, run, surface, view, write_picture

RIF = """ZONE= Interior {zone}
materials= {name}.mat
scene= {name}.rad
view= camera {view}
RESOLUTION= {size}
QUALITY= Low
render= -ab 0 -ps 1 -dj 0 -ds 0.2 -dt .05 -dc .5 -ss 0 -lw 1e-4 -lr 8
"""


def identifier(name):
    """A name without characters that Radiance gives a meaning to."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name) or "none"


def material(name, modifier, source):
    """Text of a material. Metals and glass keep their colours."""
    rough = min(source.pr**2, 0.2)
    gloss = source.ks or (0.0, 0.0, 0.0)
    # A texture is the modifier's colour.
    colour = (1.0, 1.0, 1.0) if modifier != "void" else source.kd
    if source.illum == 4:
        return f"void glass {name}\n0\n0\n3 {numbers(source.tf)}\n"
    if source.illum == 7:
        return f"void dielectric {name}\n0\n0\n5 {numbers(source.tf)} {source.ni:.9g} 0\n"
    if source.illum == 3:
        return f"{modifier} metal {name}\n0\n0\n5 {numbers(gloss)} 0.95 {rough:.9g}\n"
    return f"{modifier} plastic {name}\n0\n0\n5 {numbers(colour)} {numpy.mean(gloss):.9g} {rough:.9g}\n"


def write_materials(bundle, folder):
    """Texts of all surfaces, and their identifiers by name."""
    names = {name: f"m{index}_{identifier(name)}" for index, name in enumerate(bundle.materials)}
    pictures, texts = {}, []
    for name, source in bundle.materials.items():
        if source.emits:
            continue
        modifier = "void"
        if source.map_kd is not None:
            if source.map_kd not in pictures:
                picture = f"t{len(pictures)}.hdr"
                pictures[source.map_kd] = picture, write_picture(folder / picture, source.map_kd)
            picture, (wide, high) = pictures[source.map_kd]
            modifier = f"{names[name]}_texture"
            place = f"frac(Lu)*{wide:.9g} frac(Lv)*{high:.9g}"
            texts.append(f"void colorpict {modifier}\n7 red green blue {picture} . {place}\n0\n0\n")
        texts.append(material(names[name], modifier, source))
    return names, texts


def alias(part, names):
    """Name of a material of one object."""
    return f"{identifier(part.object)}__{names[part.material]}"


def write_mesh(parts, names, materials, path):
    """Compiles the parts of one object into a mesh."""
    lines, counts = [], numpy.zeros(3, int)
    for part in parts:
        lines.append(f"usemtl {alias(part, names)}")
        here = counts + 1
        for key, rows in (("v", part.positions), ("vt", part.uvs), ("vn", part.normals)):
            if rows is not None:
                lines += [f"{key} {numbers(row)}" for row in rows]
        for triangle in part.triangles:
            corners = []
            for corner in triangle:
                uv = "" if part.uvs is None else str(here[1] + corner)
                normal = "" if part.normals is None else f"/{here[2] + corner}"
                corners.append(f"{here[0] + corner}/{uv}{normal}")
            lines.append("f " + " ".join(corners))
        for k, rows in enumerate((part.positions, part.uvs, part.normals)):
            counts[k] += 0 if rows is None else len(rows)
    obj = path.with_suffix(".obj")
    obj.write_text("\n".join(lines) + "\n")
    run("obj2mesh", "-a", materials.name, obj.name, path.name, cwd=path.parent)
    obj.unlink()


def export(source, folder, size):
    """Writes the scene, and returns the path of its .rif file."""
    folder = Path(folder).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    bundle = bundles.read(source)
    name = identifier(bundle.name)
    names, texts = write_materials(bundle, folder)
    for part in bundle.parts:
        if not bundle.materials[part.material].emits:
            texts.append(f"void alias {alias(part, names)} {names[part.material]}\n")
    materials = folder / f"{name}.mat"
    materials.write_text("\n".join(texts))
    scene, objects = [], {}
    for part in bundle.parts:
        if not bundle.materials[part.material].emits:
            objects.setdefault(identifier(part.object), []).append(part)
            continue
        if not any(f"light {names[part.material]}\n" in text for text in scene):
            scene.append(f"void light {names[part.material]}\n0\n0\n3 {numbers(bundle.materials[part.material].ke)}\n")
        for polygon in bundles.outline(part):
            kind, arguments = surface(polygon)
            scene.append(f"{names[part.material]} {kind} lamp.{len(scene)}\n0\n0\n{arguments}\n")
    for index, (object_name, parts) in enumerate(objects.items()):
        path = folder / f"{name}-{index:03}.rtm"
        write_mesh(parts, names, materials, path)
        scene.append(f"void mesh {object_name}\n1 {path.name}\n0\n0\n")
    if bundle.environment is not None:
        scene.append(f"void glow sky\n0\n0\n4 {numbers(bundle.environment)} 0\n\nsky source heaven\n0\n0\n4 0 1 0 360\n")
    (folder / f"{name}.rad").write_text("\n".join(scene))
    positions = numpy.concatenate([part.positions for part in bundle.parts])
    zone = numbers(numpy.stack([positions.min(axis=0), positions.max(axis=0)], axis=1).ravel())
    rif = folder / f"{name}.rif"
    camera = " ".join(view(bundle.camera, size))
    rif.write_text(RIF.format(zone=zone, name=name, view=camera, size=size))
    return rif


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle")
    parser.add_argument("folder")
    parser.add_argument("--size", type=int, default=256)
    arguments = parser.parse_args()
    print(export(arguments.bundle, arguments.folder, arguments.size))


if __name__ == "__main__":
    main()
