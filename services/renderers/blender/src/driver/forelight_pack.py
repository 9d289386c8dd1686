"""Writes a copy of the open file that holds the files that it refers to."""

import contextlib

import bpy
import forelight_describe


def pack(out):
    """The files that are still outside of the copy: Blender cannot pack caches, movies and sequences of images, nor
    files that a linked library refers to."""
    for operator in (bpy.ops.file.pack_all, bpy.ops.file.pack_libraries):
        # An operator fails at the first file that it cannot read. What it left out is in the answer.
        with contextlib.suppress(RuntimeError):
            operator()
    bpy.ops.wm.save_as_mainfile(filepath=out, copy=True, compress=True, relative_remap=False)
    return {"outside": [a for a in forelight_describe.assets() if a["state"] == "present"]}
