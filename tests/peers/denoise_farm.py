"""Checks that a denoised frame of a farm has the colours of one that this machine rendered, noisy and denoised.

    denoise_farm.py HERE.exr FARM.exr STATS.json

STATS is that of the farm's frame. Needs numpy and OpenEXR.
"""

import json
import sys

import OpenEXR


def read(path):
    with OpenEXR.File(path, separate_channels=True) as file:
        return {name: channel.pixels.copy() for name, channel in file.channels().items()}


here, farm = read(sys.argv[1]), read(sys.argv[2])
for name in ("R", "G", "B", "noisy.R", "noisy.G", "noisy.B", "albedo.G", "normal.Z"):
    if not (here[name] == farm[name]).all():
        sys.exit(f"failed: the channel {name} differs")
stats = json.load(open(sys.argv[3]))["denoised"]
error, noisy = stats["error"]["p50"], stats["noisy"]["p50"]
if not 0 < error < noisy:
    sys.exit(f"failed: an error of {error} in place of {noisy}")
print(f"the same colours: error {100 * error:.1f} % in place of {100 * noisy:.1f} %")
