"""Turns scene bundles into Blender files: `blender_scenes.py OUT BUNDLE…`. Needs the module `bpy`.

Beside each NAME.blend, NAME.json says what is in it, as a renderer should describe it. Other files are small:

| file | what is special |
| --- | --- |
| `missing.blend` | it refers to a texture that does not exist |
| `script.blend` | it holds a script that writes a file when it is run |
| `linked.blend` | it has an object of `script.blend` |
| `sequence.blend` | it refers to a sequence of images, which cannot be inside a file |
| `changing.blend` | objects move, bend, appear and disappear, and are rendered otherwise than they are edited |
| `clipped.blend` | something is too near to the camera to be seen |
| `leaf.blend` | a material is transparent |
| `layers.blend` | it has a second view layer, which is rendered too |
| `composited.blend` | its compositor writes a file, in a group |
| `caches.blend` | it refers to a mesh cache and a light profile that do not exist, and to an empty folder of a simulation |
| `catcher.blend` | an object catches shadows |
| `stereo.blend` | it is rendered for two eyes |
| `counted.blend` | its images tell how many samples pixels took, at which they stop by their noise |
| `markers.blend` | markers choose the camera; the size is 70 % of one that is no multiple of ten |
| `points.blend` | geometry nodes make points, and scatter a hidden object |

Materials are Principled, lights are surfaces that emit. The camera and translations of objects are animated.
Coordinates stay as they are, with y up.
"""

import json
import math
import sys
from pathlib import Path

import bpy
import bundle
import numpy
from mathutils import Matrix, Vector


def convert(folder, out):
    """Writes the bundle as a Blender file, and what is in it as JSON."""
    scene_json = json.loads((folder / "scene.json").read_text())
    read = bundle.read(folder)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    materials = {name: principled(material) for name, material in read.materials.items()}
    parts = {}
    for part in read.parts:
        parts.setdefault(part.object or "unnamed", []).append(part)
    objects = {name: mesh(name, own, materials) for name, own in parts.items()}
    for block in objects.values():
        scene.collection.objects.link(block)
    for material in materials.values():
        if not material.users:
            bpy.data.materials.remove(material)
    world = bpy.data.worlds.new("World")
    background(world, read.environment or (0.0, 0.0, 0.0))
    scene.world = world
    animation = scene_json.get("animation", {"frames": 1, "fps": 24, "tracks": []})
    animate(scene, read.camera, animation, objects)
    settings(scene, animation)
    bpy.ops.wm.save_as_mainfile(filepath=str(out / f"{folder.name}.blend"))
    expected = {
        "first": scene.frame_start,
        "last": scene.frame_end,
        "objects": {b.name: sum(len(p.triangles) for p in parts[name]) for name, b in objects.items()},
        "materials": sorted(material.name for material in bpy.data.materials),
        "images": sorted(image.name for image in bpy.data.images if image.users),
    }
    (out / f"{folder.name}.json").write_text(json.dumps(expected))
    print(f"{folder.name}: {len(objects)} objects, {sum(expected['objects'].values())} triangles")


def nodes_of(block):
    """The node tree. Blender before 5.0 has one only if it is told so."""
    if bpy.app.version < (5, 0):
        block.use_nodes = True
    return block.node_tree


def principled(material):
    block = bpy.data.materials.new(material.name)
    nodes = nodes_of(block).nodes
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    values = {"Base Color": (*material.kd, 1.0), "Roughness": 1.0, "Specular IOR Level": 0.0}
    if material.illum == 2 and material.ks:
        values |= {"Roughness": material.pr, "Specular IOR Level": 0.5, "IOR": material.ni}
    elif material.illum == 3:
        values |= {"Base Color": (*(material.ks or bundle.GREY), 1.0), "Metallic": 1.0, "Roughness": material.pr}
    elif material.illum in (4, 7):
        values |= {"Base Color": (*material.tf, 1.0), "Transmission Weight": 1.0}
        values |= {"IOR": material.ni, "Roughness": material.pr, "Specular IOR Level": 0.5}
    if material.emits:
        values |= {"Emission Color": (*material.ke, 1.0), "Emission Strength": 1.0}
    for name, value in values.items():
        shader.inputs[name].default_value = value
    if material.map_kd and material.illum not in (3, 4, 7):
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = bpy.data.images.load(str(material.map_kd), check_existing=True)
        block.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    return block


def mesh(name, parts, materials):
    """One object of all parts, with a slot for each of its materials."""
    block = bpy.data.meshes.new(name)
    starts = numpy.cumsum([0] + [len(part.positions) for part in parts])
    vertices = numpy.concatenate([part.positions for part in parts])
    triangles = numpy.concatenate([part.triangles + start for part, start in zip(parts, starts)])
    block.from_pydata(vertices.tolist(), [], triangles.tolist())
    slots = list(dict.fromkeys(part.material for part in parts))
    for slot in slots:
        block.materials.append(materials[slot])
    of_triangle = numpy.concatenate([numpy.full(len(p.triangles), slots.index(p.material)) for p in parts])
    block.polygons.foreach_set("material_index", of_triangle.astype(numpy.int32))
    corners = [p.uvs[p.triangles].reshape(-1, 2) if p.uvs is not None else numpy.zeros((3 * len(p.triangles), 2)) for p in parts]
    block.uv_layers.new().data.foreach_set("uv", numpy.concatenate(corners).astype(numpy.float32).ravel())
    block.update()
    return bpy.data.objects.new(name, block)


def background(world, radiance):
    tree = nodes_of(world)
    node = next((n for n in tree.nodes if n.type == "BACKGROUND"), None) or tree.nodes.new("ShaderNodeBackground")
    node.inputs["Color"].default_value = (*radiance, 1.0)


def animate(scene, camera, animation, objects):
    """The camera of every frame as a key, and translations of objects."""
    data = bpy.data.cameras.new("Camera")
    data.sensor_fit = "HORIZONTAL" if camera.fov_axis == "x" else "VERTICAL"
    data.lens_unit = "FOV"
    data.angle = math.radians(camera.fov_deg)
    data.clip_start, data.clip_end = 0.001, 10000.0
    thing = bpy.data.objects.new("Camera", data)
    scene.collection.objects.link(thing)
    scene.camera = thing
    tracks = {(track["target"], track["property"]): track["keys"] for track in animation["tracks"]}
    for frame in range(animation["frames"]):
        at = {key: value_at(tracks["camera", key], frame) if ("camera", key) in tracks else getattr(camera, key) for key in ("origin", "target", "up")}
        thing.matrix_world = look_at(*(Vector(at[key]) for key in ("origin", "target", "up")))
        thing.rotation_mode = "QUATERNION"
        thing.keyframe_insert("location", frame=frame)
        thing.keyframe_insert("rotation_quaternion", frame=frame)
    for (target, what), keys in tracks.items():
        moved = objects.get(target.removeprefix("object:"))
        if moved is None or what != "translation":
            continue
        for frame in range(animation["frames"]):
            moved.location = Vector(value_at(keys, frame)) - Vector(keys[0]["value"])
            moved.keyframe_insert("location", frame=frame)


def value_at(keys, frame):
    """The value of a track, linear between its keys."""
    numbers = [key["frame"] for key in keys]
    values = numpy.array([key["value"] for key in keys], float)
    return [float(numpy.interp(frame, numbers, column)) for column in values.T]


def look_at(origin, target, up):
    back = (origin - target).normalized()
    right = up.cross(back).normalized()
    rotation = Matrix((right, back.cross(right), back)).transposed().to_4x4()
    return Matrix.Translation(origin) @ rotation


def settings(scene, animation):
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = 192
    scene.render.resolution_percentage = 50
    scene.render.fps = round(animation["fps"])
    scene.frame_start, scene.frame_end = 0, animation["frames"] - 1
    scene.cycles.samples = 64
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False


def small(out, name, change):
    """The cube of Blender's own start-up scene, changed."""
    bpy.ops.wm.read_factory_settings()
    settings(bpy.context.scene, {"fps": 24, "frames": 3})
    change()
    bpy.ops.wm.save_as_mainfile(filepath=str(out / f"{name}.blend"))


def missing_texture():
    image = bpy.data.images.new("wood", 4, 4)
    image.source, image.filepath = "FILE", "//textures/wood.png"
    nodes_of(bpy.data.materials["Material"]).nodes.new("ShaderNodeTexImage").image = image


def linked(library):
    with bpy.data.libraries.load(str(library), link=True) as (_, target):
        target.objects = ["Cube"]
    bpy.context.scene.collection.objects.link(target.objects[0])


def sequence(file):
    image = bpy.data.images.new("sea", 4, 4)
    image.filepath_raw, image.file_format = str(file), "PNG"
    image.save()
    image.source = "SEQUENCE"
    nodes_of(bpy.data.materials["Material"]).nodes.new("ShaderNodeTexImage").image = image


def script(mark):
    """A script that Blender would run when it opens the file, and a Python driver."""
    text = bpy.data.texts.new("startup.py")
    text.write(f"open({str(mark)!r}, 'w').close()\nwhile True: pass\n")
    text.use_module = True
    curve = bpy.data.objects["Cube"].driver_add("location", 0).driver
    curve.expression = f"open({str(mark)!r}, 'w').close() or 0"


def changing():
    """Everything that can change from frame to frame, each on some per cent of the image."""
    scene = bpy.context.scene
    scene.frame_end = 5
    cube = bpy.data.objects["Cube"]
    materials = [bpy.data.materials["Material"], *(bpy.data.materials.new(name) for name in ("red", "blue"))]

    def add(name, kind, place, **size):
        getattr(bpy.ops.mesh, f"primitive_{kind}_add")(location=place, **size)
        bpy.context.object.name = name
        bpy.context.object.data.materials.append(materials[len(name) % 3])
        return bpy.context.object

    def key(thing, path, *values):
        for frame, value in enumerate(values):
            setattr(thing, path, value)
            thing.keyframe_insert(path, frame=frame)

    # Of two materials, and turned about.
    cube.data.materials.append(materials[1])
    cube.data.polygons[0].material_index = cube.data.polygons[3].material_index = 1
    key(cube, "rotation_euler", *((0, 0, 0.3 * frame) for frame in range(6)))
    # A shape key.
    bent = add("bent", "plane", (3, 0, 0), size=3)
    bent.shape_key_add(name="Basis")
    shape = bent.shape_key_add(name="tall")
    for point in shape.data[:2]:
        point.co.z += 4
    key(shape, "value", 0, 0.2, 0.4, 0.4, 0.4, 1)
    # A bone.
    bpy.ops.object.armature_add(location=(0, 3, 0))
    bones = bpy.context.object
    post = add("post", "cylinder", (0, 3, 1), radius=0.7, depth=3)
    post.parent, post.parent_type = bones, "ARMATURE"
    post.vertex_groups.new(name=bones.pose.bones[0].name).add(range(len(post.data.vertices)), 1.0, "REPLACE")
    key(bones.pose.bones[0], "location", *((0, 0, 0.5 * frame) for frame in range(6)))
    # Rendered finer than it is edited, and only rendered.
    ball = add("ball", "cube", (-3, 0, 1), size=4)
    smooth = ball.modifiers.new("smooth", "SUBSURF")
    smooth.levels, smooth.render_levels, smooth.show_viewport = 0, 3, False
    # Instances of a collection, which move and are mirrored.
    group = bpy.data.collections.new("pair")
    for number, place in enumerate([(0, -4, 0), (0, -4, 2)]):
        part = add(f"part{number}", "cube", place, size=1.5)
        bpy.context.collection.objects.unlink(part)
        group.objects.link(part)
    for side in (-1, 1):
        empty = bpy.data.objects.new(f"side{side}", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", group
        empty.scale.x = side
        scene.collection.objects.link(empty)
        key(empty, "location", *((2 * side, 0.4 * frame, 0) for frame in range(6)))
    # Shown in some frames, never, and to all but the camera.
    key(add("now", "cube", (3, -3, 0), size=2), "hide_render", False, False, True, True, False, False)
    add("never", "cube", (5, -5, 3), size=2).hide_render = True
    add("unseen", "cube", (5, -5, 3), size=1).visible_camera = False


def clipped():
    # Halfway to the cube, which is 11 away.
    bpy.ops.mesh.primitive_cube_add(location=(3.7, -3.5, 2.5), size=1)
    bpy.data.cameras["Camera"].clip_start = 8


def leaf():
    nodes_of(bpy.data.materials["Material"]).nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.5


def layers():
    bpy.context.scene.view_layers.new("Again")


def composited(out):
    """The image goes through a group, which also writes it to a file."""
    scene = bpy.context.scene
    group = bpy.data.node_groups.new("writer", "CompositorNodeTree")
    group.interface.new_socket(name="Image", in_out="INPUT", socket_type="NodeSocketColor")
    writer = group.nodes.new("CompositorNodeOutputFile")
    if bpy.app.version < (5, 0):
        scene.use_nodes = True
        tree = scene.node_tree
        writer.base_path = str(out)
    else:
        tree = scene.compositing_node_group = bpy.data.node_groups.new("compositor", "CompositorNodeTree")
        tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        writer.directory = str(out)
        writer.file_output_items.new("RGBA", "Image")
    group.links.new(group.nodes.new("NodeGroupInput").outputs["Image"], writer.inputs[0])
    layers = next((n for n in tree.nodes if n.type == "R_LAYERS"), None) or tree.nodes.new("CompositorNodeRLayers")
    node = tree.nodes.new("CompositorNodeGroup")
    node.node_tree = group
    tree.links.new(layers.outputs["Image"], node.inputs["Image"])
    if bpy.app.version >= (5, 0):
        tree.links.new(layers.outputs["Image"], tree.nodes.new("NodeGroupOutput").inputs["Image"])


def caches(folder):
    folder.mkdir()
    cube = bpy.data.objects["Cube"]
    cube.modifiers.new("animation", "MESH_CACHE").filepath = "//cube.pc2"
    smoke = cube.modifiers.new("smoke", "FLUID")
    smoke.fluid_type = "DOMAIN"
    smoke.domain_settings.cache_directory = str(folder)
    profile = nodes_of(bpy.context.scene.world).nodes.new("ShaderNodeTexIES")
    profile.mode, profile.filepath = "EXTERNAL", "//lamp.ies"


def catcher():
    bpy.data.objects["Cube"].is_shadow_catcher = True


def stereo():
    bpy.context.scene.render.use_multiview = True


def counted():
    # Soft shadows are noisy, and the rest is not.
    for light in bpy.data.lights:
        light.shadow_soft_size, light.energy = 3.0, 3000.0
    for layer in bpy.context.scene.view_layers:
        layer.cycles.pass_debug_sample_count = True


def markers():
    """Two cameras, of which one looks away, and a text without a mesh: its nodes make nothing."""
    scene = bpy.context.scene
    scene.frame_end = 2
    away = scene.camera.copy()
    away.name, away.rotation_euler = "Away", (math.pi, 0, 0)
    scene.collection.objects.link(away)
    for frame, camera in ((1, scene.camera), (2, away)):
        scene.timeline_markers.new(camera.name, frame=frame).camera = camera
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 1280, 1440, 70
    bpy.ops.object.text_add()
    tree = bpy.data.node_groups.new("nothing", "GeometryNodeTree")
    tree.interface.new_socket(name="Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    tree.nodes.new("NodeGroupOutput")
    bpy.context.object.modifiers.new("nothing", "NODES").node_group = tree


def points():
    """Points on the cube, and an instance of a hidden ball at each of them."""
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.2)
    ball = bpy.context.object
    ball.hide_render, ball.pass_index = True, 1
    tree = bpy.data.node_groups.new("scatter", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket(name="Geometry", in_out=way, socket_type="NodeSocketGeometry")
    start, end, scatter, info, instance, join = (
        tree.nodes.new(kind)
        for kind in (
            "NodeGroupInput", "NodeGroupOutput", "GeometryNodeDistributePointsOnFaces", "GeometryNodeObjectInfo",
            "GeometryNodeInstanceOnPoints", "GeometryNodeJoinGeometry",
        )
    )
    info.inputs["Object"].default_value, info.inputs["As Instance"].default_value = ball, True
    tree.links.new(start.outputs[0], scatter.inputs["Mesh"])
    tree.links.new(scatter.outputs["Points"], instance.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], instance.inputs["Instance"])
    for geometry in (instance.outputs["Instances"], scatter.outputs["Points"], start.outputs[0]):
        tree.links.new(geometry, join.inputs[0])
    tree.links.new(join.outputs[0], end.inputs[0])
    bpy.data.objects["Cube"].modifiers.new("scatter", "NODES").node_group = tree


def main():
    out, folders = Path(sys.argv[1]).absolute(), [Path(name).absolute() for name in sys.argv[2:]]
    for folder in folders:
        convert(folder, out)
    small(out, "missing", missing_texture)
    small(out, "script", lambda: script(out / "script-was-run"))
    small(out, "linked", lambda: linked(out / "script.blend"))
    small(out, "sequence", lambda: sequence(out / "sea-0001.png"))
    small(out, "changing", changing)
    small(out, "composited", lambda: composited(out / "written"))
    small(out, "caches", lambda: caches(out / "smoke"))
    small(out, "catcher", catcher)
    small(out, "stereo", stereo)
    small(out, "clipped", clipped)
    small(out, "leaf", leaf)
    small(out, "layers", layers)
    small(out, "counted", counted)
    small(out, "markers", markers)
    small(out, "points", points)


if __name__ == "__main__":
    main()
