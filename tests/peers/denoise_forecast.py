"""Checks the forecast error of denoised images, by camera samples.

    denoise_forecast.py LADDERS.json SAMPLES:DENOISED.exr:CONVERGED.exr…
    denoise_forecast.py LADDERS.json SAMPLES:STATS.json…

LADDERS.json comes from `forelight accuracy --denoise --json`. With STATS.json, the error is what a render with
--denoise measured. Needs numpy and OpenEXR.
"""

import json
import sys

import numpy
import OpenEXR


def image(path):
    with OpenEXR.File(path, separate_channels=True) as file:
        return numpy.stack([file.channels()[name].pixels for name in "RGB"], axis=2).astype(float)


def true_error(files):
    """The error, and the interval that holds it."""
    if files[0].endswith(".json"):
        error = json.load(open(files[0]))["denoised"]["error"]
        return error["p50"], error["p05"], error["p95"]
    denoised, converged = map(image, files)
    error = numpy.sqrt(((denoised - converged) ** 2).mean()) / converged.mean()
    return error, error, error


ladders = json.load(open(sys.argv[1]))
without = [rung["ladder"] for rung in ladders["rungs"] if "denoised_error" not in rung]
if without:
    sys.exit(f"failed: no error after denoising on {without}")
for samples, *files in [argument.split(":") for argument in sys.argv[2:]]:
    found = [rung for rung in ladders["rungs"] if rung["ladder"] == "ambient" and rung["settings"]["spp"] == int(samples)]
    forecast = found[0]["denoised_error"]
    error, low, high = true_error(files)
    print(f"{samples} samples: {100 * error:.2f} %, forecast {100 * forecast['p50']:.2f} %"
          f" ({100 * forecast['p05']:.2f} to {100 * forecast['p95']:.2f} %)")
    # Seeds are fixed, so this is no matter of chance. But the denoiser's bits depend on the processor.
    if high < 0.9 * forecast["p05"] or low > 1.1 * forecast["p95"] or not 0.6 < forecast["p50"] / error < 1.6:
        sys.exit("failed: another error")
