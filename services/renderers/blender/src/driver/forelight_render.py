"""Renders frames, shares of their samples, and regions, and says what each cost.

Cycles tells its state to the handler `render_stats`: what it prepares, `Sample 0/8` when everything is
prepared, `Finished` when all samples are done. The CPU time at these moments divides a cost into preparing,
sampling and writing.
"""

import contextlib
import functools
import json
import re
import time

import bpy
import forelight_describe
from forelight_errors import Refused


# What Cycles prepares, by how a field of the state begins that it tells. Names of objects and files are fields of
# their own, which come later.
PREPARED = (
    (re.compile(r"Loading (\w+ )?kernels"), "kernels"),
    (re.compile(r"(Updating (\w+ )?|Building |Packing |Refitting )BVH"), "tree"),
    (re.compile(r"Updating (\w+ )?Images"), "textures"),
    (re.compile(r"Synchronizing|Updating "), "scene"),
)

# How far the samples are.
SAMPLE = re.compile(r"\bSample (\d+)/(\d+)")


def prepared(text):
    """What Cycles prepares in this state. None if it does something else."""
    for field in text.split(" | "):
        for begins, name in PREPARED:
            if begins.match(field.strip()):
                return name
    return None


class Clock:
    """CPU time of the process, divided by what Cycles does."""

    def __init__(self, progress=None):
        self.progress = progress
        self.sampling = 0
        self.sampling_since = None
        self.last_end = None
        self.told = 0.0
        # CPU time by what was prepared, what is being prepared, and since when.
        self.prepared = {}
        self.preparing = None
        self.preparing_since = 0
        # How far the samples of each view layer came. Cycles begins each at 0, and ends one that stopped so.
        self.reached = []

    def __enter__(self):
        forelight_describe.peak_memory_bytes(reset=True)
        bpy.app.handlers.render_stats.append(self.state)
        self.cpu, self.wall = time.process_time_ns(), time.monotonic_ns()
        return self

    def __exit__(self, *_):
        self.end = time.process_time_ns()
        self.wall = time.monotonic_ns() - self.wall
        bpy.app.handlers.render_stats.remove(self.state)

    def state(self, text, *_):
        now = time.process_time_ns()
        text = text if isinstance(text, str) else str(text)
        preparing = prepared(text)
        if self.last_end is None and self.sampling_since is None:
            self.prepare(preparing, now)
        sample = None if preparing else SAMPLE.search(text)
        if sample:
            done = int(sample[1])
            if not self.reached or done < self.reached[-1]:
                self.reached.append(done)
            self.reached[-1] = done
            if self.sampling_since is None:
                self.sampling_since = now
            self.tell(done, int(sample[2]))
        elif self.sampling_since is not None:
            self.sampling += now - self.sampling_since
            self.sampling_since = None
            self.last_end = now

    def prepare(self, preparing, now):
        """Counts the time since the last state for what was prepared then."""
        if self.preparing:
            spent = now - self.preparing_since
            self.prepared[self.preparing] = self.prepared.get(self.preparing, 0) + spent
        self.preparing = preparing
        self.preparing_since = now

    def before_samples(self, cpu_nanos):
        """CPU time before the first sample, divided by what was prepared."""
        rest = max(0, cpu_nanos - sum(self.prepared.values()))
        return {"prepare": rest, **self.prepared}

    def tell(self, done, whole):
        if self.progress and time.monotonic() - self.told > 0.2:
            self.told = time.monotonic()
            self.progress(done / max(1, whole))

    def cost(self):
        """The whole cost, and the parts of it that samples have no share in."""
        whole = self.end - self.cpu
        cost = {
            "cpu_nanos": whole,
            "wall_nanos": self.wall,
            "peak_memory_bytes": forelight_describe.peak_memory_bytes(),
        }
        if self.last_end is None:
            return {"cost": cost, "fixed": {}}
        write = self.end - self.last_end
        return {"cost": cost, "fixed": {**self.before_samples(whole - self.sampling - write), "write": write}}


@functools.cache
def cameras_of_markers():
    """Markers of the time line that choose cameras, with these, as the file has them."""
    return [(marker, marker.camera) for marker in bpy.context.scene.timeline_markers if marker.camera]


def prepare(frame, settings, threads, engine="CYCLES", keep=False):
    """Sets the scene to a frame and to settings, with an index for every object and material.

    `keep`: The scene stays in memory after the render, so that only what moves is prepared for the next one.
    """
    scene = bpy.context.scene
    render, cycles, own = scene.render, scene.cycles, settings["own"]
    # To set these, even to the same value, clears the memory.
    for name, value in {"engine": engine, "use_persistent_data": keep}.items():
        if getattr(render, name) != value:
            setattr(render, name, value)
    render.resolution_x, render.resolution_y = settings["width"], settings["height"]
    render.resolution_percentage = 100
    render.threads_mode, render.threads = "FIXED", threads
    render.use_border = render.use_crop_to_border = False
    render.use_overwrite, render.use_placeholder, render.use_stamp = True, False, False
    render.use_sequencer = False
    render.use_motion_blur = own.get("motion_blur", render.use_motion_blur)
    render.use_compositing = own.get("compositing", False)
    cycles.device = "CPU"
    cycles.samples = settings["samples"]
    cycles.seed = settings["seed"]
    cycles.time_limit = 0
    if has_subsets(cycles):
        cycles.use_sample_subset = False
    cycles.sample_offset = 0
    cycles.use_denoising = own.get("denoise", cycles.use_denoising)
    cycles.max_bounces = own.get("max_bounces", cycles.max_bounces)
    cycles.use_adaptive_sampling = own.get("adaptive_sampling", cycles.use_adaptive_sampling)
    cycles.adaptive_threshold = own.get("noise_threshold", cycles.adaptive_threshold)
    cycles.adaptive_min_samples = own.get("minimum_samples", cycles.adaptive_min_samples)
    # The only pattern in which a share of the samples is the same as in one render of all.
    cycles.sampling_pattern = "TABULATED_SOBOL"
    # A change of a marker changes the scene's camera, too.
    for marker, camera in cameras_of_markers():
        marker.camera = None if own.get("camera") else camera
    # One of the description's cameras: the other side refuses all others.
    if own.get("camera"):
        scene.camera = scene.objects[own["camera"]]
    if scene.camera is None:
        raise Refused("scene", "it has no camera; name one by --set camera=NAME, or make one active")
    for known in (forelight_describe.objects(), forelight_describe.materials()):
        for number, thing in enumerate(known, 1):
            # Cycles would give all others the largest index.
            index = number if number <= forelight_describe.MOST_INDICES else 0
            if thing.pass_index != index:
                thing.pass_index = index
    for layer in scene.view_layers:
        layer.use_pass_object_index = layer.use_pass_material_index = True
        if hasattr(layer.cycles, "pass_render_time"):
            layer.cycles.pass_render_time = True
    multilayer(render.image_settings)
    scene.frame_set(frame)
    return scene


def has_subsets(cycles):
    """Whether Blender can render a share of the samples: since 4.4."""
    return "use_sample_subset" in cycles.bl_rna.properties


def multilayer(image):
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format = "OPEN_EXR_MULTILAYER"
    image.color_depth = "32"
    image.exr_codec = "ZIP"


def write(scene, out):
    scene.render.filepath = out
    scene.render.use_file_extension = False
    if "FINISHED" not in bpy.ops.render.render(write_still=True):
        raise RuntimeError("Blender cancelled the render")


def samples(frame, settings, threads, out, progress, offset=None, count=None, stopping=None):
    """A frame, or with `offset` and `count` a share of its samples, into the file `out`.

    A share that is denoised or composited tells what that costs. It cannot be merged with others. In a share, no
    pixel stops by its noise: the file `stopping` tells at how many samples they would.
    """
    with Clock(progress) as clock:
        scene = prepare(frame, settings, threads, keep=stopping is not None)
        if count is None:
            write(scene, out)
        else:
            cycles = scene.cycles
            cycles.sample_offset = offset
            if has_subsets(cycles):
                cycles.use_sample_subset, cycles.sample_subset_length = True, count
            else:
                # Other samples than those of one render, for the same cost.
                cycles.samples = count
            with no_other_files(scene), changed(cycles, use_adaptive_sampling=False):
                write(scene, out)
    answer = clock.cost()
    if stopping is not None:
        answer["stopping"] = stopped(scene, settings, stopping)
        scene.render.use_persistent_data = False
    return answer


def stopped(scene, settings, out):
    """Renders few pixels of a prepared frame with all samples, until their noise is low, into the file `out`.

    The image is smaller, and so is the filter, in its pixels: each of them sees as little as one of the frame.
    """
    render, cycles = scene.render, scene.cycles
    width, height = settings["width"], settings["height"]
    divisor = max(1, min(MOST_DIVISOR, min(width, height) // LEAST_SIDE))
    filter_width = 1.0 if cycles.pixel_filter_type == "BOX" else cycles.filter_width
    all_samples = {"samples": settings["samples"], "sample_offset": 0}
    if has_subsets(cycles):
        all_samples["use_sample_subset"] = False
    layers = [layer for layer in scene.view_layers if layer.use]
    with contextlib.ExitStack() as stack:
        stack.enter_context(no_other_files(scene))
        for layer in layers:
            stack.enter_context(changed(layer.cycles, pass_debug_sample_count=True))
        small = {"resolution_x": -(-width // divisor), "resolution_y": -(-height // divisor)}
        stack.enter_context(changed(render, use_compositing=False, **small))
        narrow = {"pixel_filter_type": "BLACKMAN_HARRIS", "filter_width": max(0.01, filter_width / divisor)}
        stack.enter_context(changed(cycles, use_denoising=False, **narrow, **all_samples))
        clock = stack.enter_context(Clock())
        write(scene, out)
    reached = [samples for samples in clock.reached if samples > 0]
    return {"cost": clock.cost()["cost"], "rendered": dict(zip((layer.name for layer in layers), reached))}


# Of the image that tells how many samples pixels take: least width and height, and the most by which it is
# smaller than the frame. So it has 576 pixels at least, if the frame has. In five rooms, their mean was off by 0.2
# to 2.9 %; in a scene whose noise is in thin edges, by 8 %: there, pixels go on because their neighbours do, and
# neighbours in a small image lie further apart.
LEAST_SIDE, MOST_DIVISOR = 24, 16


@contextlib.contextmanager
def changed(block, **values):
    """Settings of Blender that are others for a while."""
    before = {name: getattr(block, name) for name in values}
    try:
        for name, value in values.items():
            setattr(block, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(block, name, value)


@contextlib.contextmanager
def no_other_files(scene):
    """The compositor writes no files of its own for a while: those of finished frames may be there."""
    tree = getattr(scene, "compositing_node_group", None) or getattr(scene, "node_tree", None)
    writers = [node for node in nodes_of(tree, set()) if node.type == "OUTPUT_FILE" and not node.mute]
    try:
        for node in writers:
            node.mute = True
        yield
    finally:
        for node in writers:
            node.mute = False


def nodes_of(tree, seen):
    """The nodes of a tree and of its groups."""
    if tree is None or tree in seen:
        return
    seen.add(tree)
    for node in tree.nodes:
        yield node
        if node.type == "GROUP":
            yield from nodes_of(node.node_tree, seen)


def one_sample(cycles):
    """One sample without bounces: the least light that Cycles can be told to trace."""
    return changed(cycles, samples=1, max_bounces=0, use_adaptive_sampling=False)


def ids(frame, settings, threads, out, progress):
    """Object and material of every pixel at one sample."""
    with Clock() as clock:
        scene = prepare(frame, settings, threads, keep=True)
        cycles, render = scene.cycles, scene.render
        cycles.use_denoising = render.use_compositing = False
        render.use_motion_blur = False
        # The one sample of a pixel is close to its centre.
        with one_sample(cycles), changed(cycles, filter_width=0.01):
            write(scene, out)
    progress(1.0)
    return clock.cost()


def regions(frame, settings, threads, out, progress, regions):
    """All samples of rectangles, one by one. The scene is prepared once.

    Regions are neither denoised nor composited. What that costs for the whole image is measured apart.
    """
    whole = Clock()
    pieces = []
    with whole:
        scene = prepare(frame, settings, threads)
        render, cycles = scene.render, scene.cycles
        denoise, composite = cycles.use_denoising, render.use_compositing
        cycles.use_denoising = render.use_compositing = False
        render.use_persistent_data = True
        render.use_border = render.use_crop_to_border = True
        width, height = settings["width"], settings["height"]
        for index, region in enumerate(regions):
            # Blender counts rows from below.
            low = height - region["y"] - region["height"]
            render.border_min_x = region["x"] / width
            render.border_max_x = (region["x"] + region["width"]) / width
            render.border_min_y, render.border_max_y = low / height, (low + region["height"]) / height
            before = whole.sampling
            bpy.ops.render.render(write_still=False)
            if index == 0:
                # Later regions find everything prepared.
                prepared = time.process_time_ns() - whole.cpu - whole.sampling
            pieces.append({"region": region, "cpu_nanos": whole.sampling - before})
            progress((index + 1) / len(regions))
        render.use_border = render.use_crop_to_border = False
        fixed = {**whole.before_samples(prepared), **finishing(scene, out, settings, denoise, composite)}
        render.use_persistent_data = False
    answer = whole.cost()
    answer["fixed"] = fixed
    answer["pieces"] = pieces
    return answer


def finishing(scene, out, settings, denoise, composite):
    """What it costs to denoise and to composite a whole image, by two renders of one sample, and to write it.

    Frames of the same size cost the same, so only the first one is measured.
    """
    known = FINISHING.get(key := json.dumps(settings, sort_keys=True))
    if known is not None:
        return known

    def cost():
        with Clock() as clock:
            write(scene, out)
        return clock.end - clock.cpu, clock.cost()["fixed"].get("write", 0)

    with one_sample(scene.cycles), no_other_files(scene):
        plain, written = cost()
        found = {"write": written}
        if denoise or composite:
            with changed(scene.cycles, use_denoising=denoise), changed(scene.render, use_compositing=composite):
                found["finish"] = max(0, cost()[0] - plain)
    FINISHING[key] = found
    return found


# Costs that `finishing` has measured, by settings.
FINISHING = {}
