"""Hands out what a frame shows as triangles, so that previews need no render.

Only a render engine is given objects as they are rendered: with the modifiers, the visibility and the instances of a
render. So this module is a render engine. It traces no light, and writes triangles in the world's coordinates into a
file instead. Blender tells it what has changed since its last frame, and only that is written again.
"""

import uuid

import bpy
import forelight_describe
import forelight_render
import numpy

# More triangles than this are not handed out: scenes of instances may have billions. They take a gigabyte.
MOST_TRIANGLES = 5_000_000


class NotDrawn(Exception):
    """Why the frame cannot be previewed by its triangles."""


def triangles(frame, settings, threads, out, progress, after):
    """Triangles of a frame that changed since the step `after`, which handed out another frame, as the file `out`.

    The file has for each piece its positions (3 floats a vertex), its triangles (3 indices each), and the number of
    the material of each triangle, -1 for none. The answer says what is in it, in order, and which pieces are gone. If
    `after` was not the last step of this process, everything is written: `whole`.
    """
    with forelight_render.Clock() as clock:
        scene = forelight_render.prepare(frame, settings, threads, Engine.bl_idname, keep=True)
        try:
            check(scene)
            EXPORT.begin(out, after)
            render = scene.render
            render.use_compositing = render.use_motion_blur = False
            bpy.ops.render.render(write_still=False)
            answer = EXPORT.answer()
        except NotDrawn as why:
            answer = {"refused": str(why)}
        except Exception as error:  # noqa: BLE001: Cycles may show what this cannot
            answer = {"refused": f"{type(error).__name__}: {error}"}
    progress(1.0)
    return {**answer, "cost": clock.cost()["cost"]}


def check(scene):
    camera, render = scene.camera.data, scene.render
    if scene.camera.type != "CAMERA":
        raise NotDrawn(f"the camera is the object {scene.camera.name} of kind {scene.camera.type}")
    if camera.type != "PERSP":
        raise NotDrawn(f"camera {scene.camera.name} is of type {camera.type}")
    if camera.shift_x or camera.shift_y:
        raise NotDrawn(f"the lens of camera {scene.camera.name} is shifted")
    if render.pixel_aspect_x != render.pixel_aspect_y:
        raise NotDrawn("pixels are not square")
    if any(layer.material_override for layer in scene.view_layers):
        raise NotDrawn("a view layer overrides materials")
    if reason := forelight_describe.why_no_triangles():
        raise NotDrawn(reason)


class Export:
    """What was handed out, and what is being handed out."""

    def __init__(self):
        # The last step.
        self.step = None
        # Every piece that was handed out: its number, place and number of triangles, by what identifies it.
        self.pieces = {}
        self.numbers = 0

    def begin(self, out, after):
        self.out = out
        self.whole = after is None or after != self.step
        if self.whole:
            self.pieces = {}
        # Known again once all is written.
        self.step = None
        self.is_called = False
        self.result, self.failure = None, RuntimeError("Blender did not render the frame")

    def answer(self):
        if self.failure:
            raise self.failure
        self.step = self.result["step"]
        return self.result

    def frame(self, depsgraph):
        """Writes what changed in the frame that a render engine was given."""
        changed, bent = set(), False
        for update in depsgraph.updates:
            if isinstance(update.id, bpy.types.Object) and (update.is_updated_geometry or update.is_updated_transform):
                changed.add(update.id.original.as_pointer())
                bent = bent or update.is_updated_geometry
        shown, written, count = {}, [], 0
        with open(self.out, "wb") as file:
            for instance in depsgraph.object_instances:
                thing = instance.object
                if not instance.show_self or thing.type not in forelight_describe.GEOMETRY or is_unseen(instance):
                    continue
                if thing.type in forelight_describe.NO_TRIANGLES:
                    raise NotDrawn(f"instances of {thing.name} are of kind {thing.type}")
                owner = thing.original.as_pointer()
                key = (owner, instance.parent.original.as_pointer(), *instance.persistent_id) if instance.is_instance else owner
                place = tuple(value for row in instance.matrix_world for value in row)
                number, before, triangles = self.pieces.get(key, (None, None, 0))
                # What bends an instance may be any object on the way to it.
                if number is None or place != before or owner in changed or (bent and instance.is_instance):
                    number = number or self.next_number()
                    sizes = write(file, thing, instance.matrix_world, MOST_TRIANGLES - count)
                    written.append({"piece": number, "object": thing.pass_index - 1, **sizes})
                    triangles = sizes["triangles"]
                count += triangles
                if count > MOST_TRIANGLES:
                    raise too_many()
                shown[key] = number, place, triangles
        gone = sorted({number for number, _, _ in self.pieces.values()} - {number for number, _, _ in shown.values()})
        self.pieces = shown
        self.result = {
            "step": uuid.uuid4().hex,
            "whole": self.whole,
            "camera": camera(depsgraph),
            "written": written,
            "gone": gone,
        }

    def next_number(self):
        self.numbers += 1
        return self.numbers


EXPORT = Export()


def is_unseen(instance):
    """Whether the camera does not see the instance. Holdouts are left to Cycles."""
    things = [instance.object, instance.parent] if instance.is_instance else [instance.object]
    if any(thing.is_holdout for thing in things):
        raise NotDrawn(f"object {instance.object.name} is a holdout")
    return not all(thing.visible_camera for thing in things)


def too_many():
    return NotDrawn(f"it has over {MOST_TRIANGLES // 1_000_000} million triangles")


class Engine(bpy.types.RenderEngine):
    bl_idname = "FORELIGHT_TRIANGLES"
    bl_label = "Triangles for previews"

    def render(self, depsgraph):
        # Of several layers, the first is previewed.
        if EXPORT.is_called:
            return
        EXPORT.is_called = True
        try:
            EXPORT.frame(depsgraph)
            EXPORT.failure = None
        except Exception as error:  # noqa: BLE001: Blender would only print it; it is raised again where it was asked
            EXPORT.failure = error


bpy.utils.register_class(Engine)


def camera(depsgraph):
    """Position and axes of the camera, and the tangents of half its angles of view."""
    scene = depsgraph.scene
    thing, render = scene.camera.evaluated_get(depsgraph), scene.render
    projection = thing.calc_matrix_camera(depsgraph, x=render.resolution_x, y=render.resolution_y)
    axes = thing.matrix_world.to_3x3()
    right, up, back = (axes.col[axis].normalized() for axis in range(3))
    return {
        "origin": list(thing.matrix_world.translation),
        "right": list(right),
        "up": list(up),
        "forward": list(-back),
        "tan_half_x": 1 / projection[0][0],
        "tan_half_y": 1 / projection[1][1],
    }


def write(file, thing, matrix, most):
    """Writes an evaluated object as triangles, at most so many. Says how many vertices and triangles it has."""
    mesh = thing.to_mesh()
    if mesh is None:
        return {"vertices": 0, "triangles": 0}
    mesh.calc_loop_triangles()
    if len(mesh.loop_triangles) > most:
        raise too_many()
    positions = numpy.empty((len(mesh.vertices), 3), numpy.float32)
    mesh.vertices.foreach_get("co", positions.ravel())
    world = numpy.array(matrix, numpy.float32)
    positions = positions @ world[:3, :3].T + world[:3, 3]
    corners = numpy.empty(3 * len(mesh.loop_triangles), numpy.int32)
    mesh.loop_triangles.foreach_get("vertices", corners)
    slots = numpy.empty(len(mesh.loop_triangles), numpy.int32)
    mesh.loop_triangles.foreach_get("material_index", slots)
    thing.to_mesh_clear()
    # Blender takes the last slot for an index beyond it.
    known = [slot.material.pass_index - 1 if slot.material else -1 for slot in thing.material_slots] or [-1]
    materials = numpy.array(known, numpy.int32)[slots.clip(0, len(known) - 1)]
    for array in (positions.astype("<f4"), corners.astype("<i4"), materials.astype("<i4")):
        file.write(array.tobytes())
    return {"vertices": len(positions), "triangles": len(materials)}
