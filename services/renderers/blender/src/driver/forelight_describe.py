"""What is in the open file: frames, cameras, objects, materials, settings, and the files that it refers to."""

import functools
import glob
import os
import re

import bpy

# Kinds of objects that have a surface or a volume.
GEOMETRY = {
    "MESH", "CURVE", "CURVES", "SURFACE", "FONT", "META", "POINTCLOUD", "VOLUME", "GREASEPENCIL", "GPENCIL",
}
# Most objects, and most materials, that pixels can be told apart by.
MOST_INDICES = 32767
# Kinds among them that are not made of triangles.
NO_TRIANGLES = {"CURVES", "POINTCLOUD", "VOLUME", "GREASEPENCIL", "GPENCIL"}


def objects():
    """The file's objects with geometry, in the order of their names. They are the same in every frame. What is hidden
    may be instanced."""
    found = [o for o in bpy.data.objects if o.type in GEOMETRY and o.users]
    return sorted(found, key=lambda o: (o.name, o.library.filepath if o.library else ""))


def may_be_rendered(thing):
    """Whether the object is rendered in any frame. What is animated may appear."""
    return not thing.hide_render or bool(thing.animation_data)


def materials():
    """The file's materials, in the order of their names."""
    found = [m for m in bpy.data.materials if m.users]
    return sorted(found, key=lambda m: (m.name, m.library.filepath if m.library else ""))


def describe(scene):
    render = scene.render
    known = objects()
    answer = {
        "frames": {"first": scene.frame_start, "last": scene.frame_end, "step": scene.frame_step},
        "frames_per_second": render.fps / render.fps_base,
        "cameras": [
            {"name": o.name, "active": o == scene.camera} for o in scene.objects if o.type == "CAMERA"
        ],
        "layers": [layer.name for layer in scene.view_layers if layer.use],
        "objects": [{"name": o.name, "kind": o.type, "triangles": triangles(o)} for o in known],
        "materials": [m.name for m in materials()],
        "settings": settings(scene),
        "assets": list(assets()),
        "notes": list(notes(known)),
        "indivisible": why_indivisible(known),
    }
    if not scene.camera:
        answer["notes"].append("no camera is active: name one by the setting `camera`")
    return answer


def why_indivisible(known):
    """Why shares of the samples do not add up to one render. None if they may do."""
    for thing in filter(may_be_rendered, known):
        if thing.is_shadow_catcher:
            return f"object {thing.name} catches shadows, and a shadow is a quotient of two images"
    return None


def triangles(thing):
    """Triangles of an object as evaluated in the current frame. `None` if it has none, or is not rendered."""
    if thing.type in NO_TRIANGLES or not may_be_rendered(thing):
        return None
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    try:
        mesh = evaluated.to_mesh()
    except RuntimeError:
        return None
    # A curve or a text whose modifiers leave no mesh.
    if mesh is None:
        return 0
    # A polygon with n corners has n - 2 triangles.
    count = len(mesh.loops) - 2 * len(mesh.polygons)
    evaluated.to_mesh_clear()
    return count


def settings(scene):
    """The settings that the file has, by the names of the schema."""
    render, cycles = scene.render, scene.cycles
    own = {
        "adaptive_sampling": cycles.use_adaptive_sampling,
        "noise_threshold": cycles.adaptive_threshold,
        "minimum_samples": cycles.adaptive_min_samples,
        "denoise": cycles.use_denoising,
        "compositing": composited(scene),
        "motion_blur": render.use_motion_blur,
        "max_bounces": cycles.max_bounces,
    }
    # Where markers of the time line choose cameras, a name would stand for all frames.
    if scene.camera and not any(marker.camera for marker in scene.timeline_markers):
        own["camera"] = scene.camera.name
    return {
        # In whole numbers, as Blender does.
        "width": max(1, render.resolution_x * render.resolution_percentage // 100),
        "height": max(1, render.resolution_y * render.resolution_percentage // 100),
        "samples": cycles.samples,
        "seed": max(0, cycles.seed),
        "own": own,
    }


def composited(scene):
    """Whether the file's compositor changes its images."""
    if not scene.render.use_compositing:
        return False
    if hasattr(scene, "compositing_node_group"):
        return scene.compositing_node_group is not None
    return scene.use_nodes


@functools.cache
def why_no_triangles():
    """What of the file triangles do not show. None if they show what is rendered."""
    return next(without_triangles(), None)


def without_triangles():
    for thing in filter(may_be_rendered, objects()):
        if thing.type in NO_TRIANGLES:
            yield f"object {thing.name} is of kind {thing.type}"
        if any(system.settings.type == "HAIR" for system in thing.particle_systems):
            yield f"object {thing.name} has hair"
    for material in materials():
        if reason := see_through(material):
            yield f"material {material.name} {reason}"


def see_through(material):
    """Why the surface of a material may show what is behind it, or be somewhere else. None if it does not."""
    tree = material.node_tree
    if not tree:
        return None
    output = tree.get_output_node("CYCLES")
    if not output or not output.inputs["Surface"].links:
        return "has no surface"
    if output.inputs["Displacement"].links and material.displacement_method != "BUMP":
        return "displaces the surface"
    if any(map(is_see_through, nodes_before(output))):
        return "is transparent"
    return None


def is_see_through(node):
    if node.type == "BSDF_PRINCIPLED":
        alpha = node.inputs["Alpha"]
        return bool(alpha.links) or alpha.default_value < 1.0 or bool(node.id_data.animation_data)
    # Nobody knows what a script does.
    return node.type in {"BSDF_TRANSPARENT", "HOLDOUT", "SCRIPT"}


def nodes_before(output):
    """The nodes that an output depends on. Of a group of nodes, all."""
    seen, waiting = set(), [output]
    while waiting:
        node = waiting.pop()
        if node in seen:
            continue
        seen.add(node)
        yield node
        waiting.extend(link.from_node for socket in node.inputs for link in socket.links)
        if node.type == "GROUP" and node.node_tree:
            waiting.extend(node.node_tree.nodes)


def notes(known):
    if bpy.app.autoexec_fail:
        yield f"scripts of the file are not run: {bpy.app.autoexec_fail_message or 'Python drivers'}"
    for text in bpy.data.texts:
        if text.use_module:
            yield f"script {text.name} of the file is not run"
    if reason := why_no_triangles():
        yield f"Cycles renders the previews, because triangles do not show all: {reason}"
    for kind, things in (("objects", known), ("materials", materials())):
        if len(things) > MOST_INDICES:
            yield f"only {MOST_INDICES} of {len(things)} {kind} are told apart; the others have no name"
    if any(o.particle_systems for o in known):
        yield "particle systems are rendered as they are cached"


def assets():
    """Files that the scene refers to, with whether they exist."""
    for library in bpy.data.libraries:
        yield asset("library", library, library.filepath, library.packed_file)
    for image in bpy.data.images:
        if image.users and image.source in {"FILE", "SEQUENCE", "MOVIE", "TILED"} and image.filepath:
            yield asset("image", image, image.filepath, image.packed_file or image.packed_files)
    for font in bpy.data.fonts:
        if font.users and font.filepath != "<builtin>":
            yield asset("font", font, font.filepath, font.packed_file)
    for volume in bpy.data.volumes:
        if volume.users and volume.filepath:
            yield asset("volume", volume, volume.filepath, volume.packed_file)
    for cache in bpy.data.cache_files:
        if cache.users:
            yield asset("cache", cache, cache.filepath, None)
    for clip in bpy.data.movieclips:
        if clip.users:
            yield asset("movie clip", clip, clip.filepath, None)
    for thing in filter(may_be_rendered, bpy.data.objects):
        for path, must_exist in caches_of(thing):
            found = asset("cache", thing, path, None)
            if must_exist or found["state"] == "present":
                yield found
    for tree in trees():
        for node in tree.nodes:
            if node.type == "TEX_IES" and node.mode == "EXTERNAL" and node.filepath:
                yield asset("light profile", tree, node.filepath, None)


def caches_of(thing):
    """Files and folders with simulations and animations of an object, and whether they must exist. A simulation that
    is not baked may have none."""
    for modifier in thing.modifiers:
        if modifier.type == "MESH_CACHE" and modifier.filepath:
            yield modifier.filepath, True
        elif modifier.type == "OCEAN" and modifier.is_cached:
            yield modifier.filepath, True
        elif modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN":
            domain = modifier.domain_settings
            yield domain.cache_directory, domain.has_cache_baked_any
        elif modifier.type == "NODES" and modifier.bake_directory:
            yield modifier.bake_directory, False
    systems = [*thing.particle_systems, *(m for m in thing.modifiers if m.type in {"CLOTH", "SOFT_BODY"})]
    for cache in (system.point_cache for system in systems):
        if cache.use_external and cache.filepath:
            yield cache.filepath, True
        elif cache.use_disk_cache:
            name, _ = os.path.splitext(os.path.basename(bpy.data.filepath))
            yield f"//blendcache_{name}", cache.is_baked


def trees():
    """Trees of nodes of what gives light or reflects it, and of groups."""
    blocks = [*bpy.data.materials, *bpy.data.lights, *bpy.data.worlds]
    return [block.node_tree for block in blocks if block.users and block.node_tree] + list(bpy.data.node_groups)


def asset(kind, block, path, packed):
    # A path that begins with // is relative to the file that it stands in, which may be a library.
    library = getattr(block, "library", None)
    path = os.path.normpath(bpy.path.abspath(path, library=library))
    state = "packed" if packed else "present" if exists(path) else "missing"
    return {"kind": kind, "name": block.name, "path": path, "state": state}


def exists(path):
    """Whether the file exists, or some file of the sequence or of the tiles that it stands for."""
    if os.path.exists(path):
        return True
    folder, name = os.path.split(path)
    if "<UDIM>" in name or "<UVTILE>" in name:
        pattern = re.sub("<UDIM>|<UVTILE>", "*", glob.escape(name).replace("[<]", "<"))
        return bool(glob.glob(os.path.join(glob.escape(folder), pattern)))
    return False


def peak_memory_bytes(reset=False):
    """Largest resident memory of this process, since the last reset where the system has one."""
    if reset:
        try:
            with open("/proc/self/clear_refs", "w") as file:
                file.write("5")
        except OSError:
            pass
        return 0
    with open("/proc/self/status") as file:
        return next((int(line.split()[1]) * 1024 for line in file if line.startswith("VmHWM")), 0)
