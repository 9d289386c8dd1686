"""Answers questions about one Blender file. Runs inside Blender, or in a Python with the `bpy` module.

Standard input has one JSON object a line: `{"do": NAME, …}`. Every answer is a line on standard output that
begins with `forelight ` and goes on with a JSON object: `{"progress": 0 to 1}`, then `{"answer": FILE}` or
`{"error": {"kind": …, "message": …}}`. FILE holds the answer as JSON, because lines have a bounded length.
The end of the input ends the driver.

Blender itself prints to standard output. So the driver keeps that stream for answers alone, and sends
everything else to standard error.
"""

import json
import os
import sys
import time

ANSWERS = os.fdopen(os.dup(1), "w", encoding="utf-8")
QUESTIONS = os.fdopen(os.dup(0), "r", encoding="utf-8")
os.dup2(2, 1)
with open(os.devnull) as nothing:
    os.dup2(nothing.fileno(), 0)
FOLDER = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, FOLDER)
from forelight_errors import Refused  # noqa: E402: the line above finds it

# Longest message of an error, in characters.
LONGEST_MESSAGE = 2000


def text_of(what):
    """JSON in UTF-8. Names of files may have bytes that are not: these become question marks."""
    return json.dumps(what, ensure_ascii=False).encode("utf-8", "replace").decode("utf-8")


def say(what):
    ANSWERS.write("forelight " + text_of(what) + "\n")
    ANSWERS.flush()


def reply(what):
    path = os.path.join(FOLDER, "answer.json")
    with open(path, "w", encoding="utf-8") as file:
        file.write(text_of(what))
    say({"answer": path})


def fail(kind, message):
    say({"error": {"kind": kind, "message": message.strip()[:LONGEST_MESSAGE]}})


def load_blender(threads):
    """Imports Blender with as many threads in its pool as there will be to render with.

    The pool (oneTBB) has a thread for every processor that the process may use when it starts. Threads beyond
    those that render would wait in a busy loop: that doubled the CPU time of a render with one thread.
    """
    can_bind = hasattr(os, "sched_setaffinity")
    allowed = sorted(os.sched_getaffinity(0)) if can_bind else []
    if can_bind:
        os.sched_setaffinity(0, allowed[:threads])
    try:
        import bpy
        import forelight_describe
    finally:
        if can_bind:
            os.sched_setaffinity(0, allowed)
    return bpy, forelight_describe


def open_scene(scene, threads):
    bpy, forelight_describe = load_blender(threads)
    # Neither scripts nor Python drivers of the file are run, whatever its user chose once.
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    try:
        bpy.ops.wm.open_mainfile(filepath=scene, load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise Refused("scene", str(error).strip().removeprefix("Error: ")) from None
    engine = bpy.context.scene.render.engine
    if engine != "CYCLES":
        raise Refused("scene", f"its render engine is {engine}; only CYCLES can be forecast")
    if bpy.context.scene.render.use_multiview:
        raise Refused("scene", "it renders several views; switch off Stereoscopy in its output properties")
    answer = forelight_describe.describe(bpy.context.scene)
    answer["opening"] = {
        "cpu_nanos": time.process_time_ns(),
        "wall_nanos": time.monotonic_ns() - STARTED,
        "peak_memory_bytes": forelight_describe.peak_memory_bytes(),
    }
    return answer


def answer(question):
    todo = question.pop("do")
    if todo == "open":
        return open_scene(**question)
    if todo == "pack":
        import forelight_pack

        return forelight_pack.pack(**question)
    import forelight_render

    def triangles(**asked):
        # Only this needs numpy.
        import forelight_triangles

        return forelight_triangles.triangles(**asked)

    ask = {
        "ids": forelight_render.ids,
        "samples": forelight_render.samples,
        "regions": forelight_render.regions,
        "triangles": triangles,
    }[todo]
    return ask(progress=lambda share: say({"progress": share}), **question)


def main():
    for line in QUESTIONS:
        try:
            reply(answer(json.loads(line)))
        except Refused as error:
            fail(error.kind, str(error))
        except MemoryError:
            fail("out_of_memory", "Blender ran out of memory")
        except Exception as error:  # noqa: BLE001: whatever it is, the other side has to know
            fail("failed", f"{type(error).__name__}: {error}")


STARTED = time.monotonic_ns()
main()
