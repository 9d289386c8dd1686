"""Checks a denoised image.

    denoise_peer.py NOISY.exr DENOISED.exr CONVERGED.exr STATS.json

NOISY and DENOISED were rendered with the same samples, and DENOISED with the flag --denoise. Needs numpy,
OpenEXR and pyoidn.
"""

import json
import sys

import numpy
import OpenEXR
import pyoidn


def read(path):
    """The file's header, and a function that returns three of its channels as height × width × 3."""
    with OpenEXR.File(path, separate_channels=True) as file:
        channels = {name: channel.pixels.copy() for name, channel in file.channels().items()}
        header = dict(file.header())
    return header, lambda *names: numpy.ascontiguousarray(numpy.stack([channels[name] for name in names], axis=2))


def check(condition, text):
    if not condition:
        sys.exit(f"failed: {text}")


noisy_header, noisy = read(sys.argv[1])
header, denoised = read(sys.argv[2])
_, converged = read(sys.argv[3])
stats = json.load(open(sys.argv[4]))["denoised"]

image, before, truth = denoised("R", "G", "B"), noisy("R", "G", "B"), converged("R", "G", "B")
check((denoised("noisy.R", "noisy.G", "noisy.B") == before).all(), "the noisy layer is not the image without --denoise")
check("denoised" not in noisy_header, "an image with noise is marked as denoised")
check(header["denoised"] == stats["by"] == "Open Image Denoise 2.5.1", f"marked as {header.get('denoised')}")

albedo = denoised("albedo.R", "albedo.G", "albedo.B")
normal = denoised("normal.X", "normal.Y", "normal.Z")
check(albedo.min() >= 0 and albedo.max() <= 1 and albedo.std() > 0.1, "albedo")
check(numpy.linalg.norm(normal, axis=2).max() < 1.001 and normal.std() > 0.1, "normals")
theirs = pyoidn.denoise(before, albedo=albedo, normal=normal, hdr=True)
difference = numpy.abs(theirs - image).max() / truth.mean()
check(difference < 1e-4, f"another image than from Python: {difference:.2e} of the mean")


def error(found):
    return float(numpy.sqrt(((found.astype(float) - truth) ** 2).mean()) / truth.mean())


for name, found in [("noisy", before), ("error", image)]:
    true, measured = error(found), stats[name]
    print(f"{name}: {100 * true:.2f} %, measured {100 * measured['p50']:.2f} %"
          f" ({100 * measured['p05']:.2f} to {100 * measured['p95']:.2f} %)")
    # Nine of ten lie between the two. The samples are fixed, so this is no matter of chance.
    check(measured["p05"] <= true <= measured["p95"], f"the true {name} is outside of the interval")
check(stats["measured_samples"] >= 64 and stats["measured_pixels"] >= 128, f"{stats}")
