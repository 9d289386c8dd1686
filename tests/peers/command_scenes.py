"""Writes scenes for programs that can only be started, and the files that describe these programs:
`command_scenes.py OUT [BUNDLE…]`.

  hall.pov             a POV-Ray scene of 24 frames; the camera and a ball move with `clock`
  missing.pov          a scene that includes a file that does not exist
  pov-*.command.toml   POV-Ray at smaller sizes, and in regions
  NAME.xml             a bundle for Mitsuba's program; `frame` turns the camera
  NAME-*.command.toml  Mitsuba at fewer samples, at smaller sizes, and in regions

The second part of a name says what of the program is used: `samples`, `size` or `crop`.
"""

import sys
from pathlib import Path
from xml.sax.saxutils import quoteattr

FRAMES = "[frames]\nfirst = 1\nlast = 24\n"

HALL = """#version 3.7;
global_settings { assumed_gamma 1.0 max_trace_level 8 }
#declare T = clock / 24;
camera { location <-6 + 9 * T, 2.2, -8 + 3 * T> look_at <0, 1.2, 2> right x * image_width / image_height angle 60 }
light_source { <2, 6, -4> color rgb 0.9 area_light <1, 0, 0>, <0, 0, 1>, 4, 4 adaptive 1 jitter }
light_source { <-5, 5, 3> color rgb 0.4 }
plane { y, 0 pigment { checker color rgb 0.8, color rgb 0.3 } finish { reflection 0.15 } }
plane { y, 8 pigment { color rgb 0.7 } }
sphere { <-3 + 6 * T, 1, 1>, 1 pigment { color rgbt <0.9, 1, 0.9, 0.9> } interior { ior 1.5 } finish { reflection 0.1 } }
#declare I = 0;
#while (I < 8)
  cylinder { <-7 + 2 * I, 0, 5>, <-7 + 2 * I, 8, 5>, 0.4 pigment { granite scale 0.6 } normal { bumps 0.4 scale 0.1 } }
  sphere { <-7 + 2 * I, 0.5, 3 - mod(I, 3)>, 0.5 pigment { color rgb <0.9, 0.6, 0.2> } finish { reflection 0.4 specular 0.6 } }
  #declare I = I + 1;
#end
"""

POV = """name = "pov-ray"
version_command = ["povray", "--version"]
version_pattern = 'POV-Ray (\\d\\S*)'
scene = "hall.pov"
output = "frame-{frame:04}.png"
arguments = ["povray", "+I{scene}", "+O{out}", "+FN", "+W{width}", "+H{height}", "+K{frame}", "+WT{threads}", "-D", "+V",
             "+A{antialias}", "+SC{crop_left}", "+SR{crop_top}", "+EC{crop_right}", "+ER{crop_bottom}"]
can = [CAN]

[defaults]
width = 160
height = 90

[crop]
first = 1
inclusive = true

[parameters.antialias]
type = "number"
default = 0.3
minimum = 0

[progress]
pattern = 'Rendered \\d+ of \\d+ pixels \\((\\d+)%\\)'
unit = "percent"

[[errors]]
pattern = "'.*', even after trying"
means = "missing_file"

"""

# With fewer than three threads Mitsuba hangs while it writes the image.
MITSUBA = """name = "mitsuba"
version_command = ["MITSUBA", "--help"]
version_pattern = 'Mitsuba version (\\d[\\d.]*)'
scene = "NAME.xml"
output = "frame-{frame:04}.exr"
arguments = ["MITSUBA", "-m", "scalar_rgb", "-t", "3", "-o", "{out}", "-Dframe={frame}", "-Dsamples={samples}",
             "-Dseed={seed}", "-Dwidth={width}", "-Dheight={height}", "-Dleft={crop_left}", "-Dtop={crop_top}",
             "-Dcolumns={crop_width}", "-Drows={crop_height}", "{scene}"]
can = [CAN]
pass_on = ["LD_LIBRARY_PATH"]

[defaults]
width = 64
height = 64
samples = 32

[limits]
seconds = 120

"""

BSDF = {"diffuse", "twosided", "conductor", "roughconductor", "dielectric", "thindielectric", "plastic", "roughplastic"}


def write(out, name, text, can):
    abilities = ", ".join(f'"{ability}"' for ability in can)
    (out / f"{name}-{can[0]}.command.toml").write_text(text.replace("CAN", abilities) + FRAMES)


def element(name, value):
    """A value of a Mitsuba dictionary as XML."""
    named = f"name={quoteattr(name)}" if name else ""
    if isinstance(value, bool):
        return f'<boolean {named} value="{str(value).lower()}"/>'
    if isinstance(value, (int, float)):
        return f'<float {named} value="{value:.9g}"/>'
    if isinstance(value, str):
        return f"<string {named} value={quoteattr(value)}/>"
    value = dict(value)
    kind = value.pop("type")
    if kind == "rgb":
        numbers = value["value"] if hasattr(value["value"], "__iter__") else [value["value"]]
        return f'<rgb {named} value="{", ".join(f"{float(number):.9g}" for number in numbers)}"/>'
    tag = "bsdf" if kind in BSDF else "texture"
    inside = "".join(element("" if key == "bsdf" else key, inner) for key, inner in value.items())
    return f'<{tag} type="{kind}" {"" if tag == "bsdf" else named}>{inside}</{tag}>'


def convert(folder, out):
    """Writes the bundle for Mitsuba. The camera stays where it is, and turns by a degree per frame."""
    import bundle
    import mitsuba_peer

    read = bundle.read(folder)
    camera = read.camera
    ahead = [target - origin for target, origin in zip(camera.target, camera.origin)]
    numbers = lambda values: ", ".join(f"{float(value):.9g}" for value in values)
    defaults = {"frame": 1, "samples": 64, "seed": 0, "width": 96, "height": 96, "left": 0, "top": 0, "columns": 96, "rows": 96}
    film = {"width": "width", "height": "height", "crop_offset_x": "left", "crop_offset_y": "top"}
    film |= {"crop_width": "columns", "crop_height": "rows"}
    lines = ['<scene version="3.0.0">']
    lines += [f'<default name="{name}" value="{value}"/>' for name, value in defaults.items()]
    lines += ['<integrator type="path"><integer name="max_depth" value="4"/></integrator>', '<sensor type="perspective">']
    lines += [f'<float name="fov" value="{camera.fov_x(1, 1):.9g}"/><string name="fov_axis" value="x"/>']
    lines += ['<float name="near_clip" value="1e-3"/><float name="far_clip" value="1e5"/>', '<transform name="to_world">']
    lines += [f'<lookat origin="0, 0, 0" target="{numbers(ahead)}" up="{numbers(camera.up)}"/>']
    lines += [f'<rotate y="1" angle="$frame"/><translate value="{numbers(camera.origin)}"/></transform>']
    lines += ['<sampler type="independent"><integer name="sample_count" value="$samples"/>']
    lines += ['<integer name="seed" value="$seed"/></sampler>', '<film type="hdrfilm"><rfilter type="box"/>']
    lines += [f'<integer name="{name}" value="${value}"/>' for name, value in film.items()]
    lines += ["</film></sensor>"]
    if read.environment is not None:
        lines.append(f'<emitter type="constant"><rgb name="radiance" value="{numbers(read.environment)}"/></emitter>')
    for index, part in enumerate(read.parts):
        mitsuba_peer.write_ply(out / f"{folder.name}-{index}.ply", part)
        material = read.materials[part.material]
        lines.append(f'<shape type="ply"><string name="filename" value="{folder.name}-{index}.ply"/>')
        lines.append(f'<boolean name="face_normals" value="{str(part.normals is None).lower()}"/>')
        lines.append(element("", mitsuba_peer.bsdf(material, "full")))
        if material.emits:
            lines.append(f'<emitter type="area"><rgb name="radiance" value="{numbers(material.ke)}"/></emitter>')
        lines.append("</shape>")
    (out / f"{folder.name}.xml").write_text("\n".join([*lines, "</scene>", ""]))


def main():
    out = Path(sys.argv[1])
    (out / "hall.pov").write_text(HALL)
    (out / "missing.pov").write_text('#version 3.7;\n#include "nowhere.inc"\n')
    for can in (["size", "crop"], ["crop"]):
        write(out, "pov", POV, can)
    for folder in map(Path, sys.argv[2:]):
        convert(folder, out)
        text = MITSUBA.replace("NAME", folder.name).replace("MITSUBA", str(Path(sys.executable).parent / "mitsuba"))
        for can in (["samples", "size", "crop"], ["size", "crop"], ["crop"]):
            write(out, folder.name, text, can)


if __name__ == "__main__":
    main()
