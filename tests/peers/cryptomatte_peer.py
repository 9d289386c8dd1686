"""Checks the Cryptomatte of EXR files of one frame.

    cryptomatte_peer.py MANY.exr ONE.exr LARGE.exr

MANY has 16 samples of each pixel, ONE has one, and LARGE has one in each pixel of a larger image. Needs numpy,
OpenEXR, mmh3 and cryptomatte-api.
"""

import json
import sys

import mmh3
import numpy
import OpenEXR
from cryptomatte_api import Cryptomatte

LAYERS = {"CryptoObject": "object.id", "CryptoMaterial": "material.id"}
RANKS = 4


def bits(name):
    """The id of a name, by the specification."""
    value = mmh3.hash(name, signed=False)
    return value ^ 1 << 23 if value >> 23 & 255 in (0, 255) else value


def read(path, layer):
    """Ids as bits and coverage, both height × width × ranks, the manifest, and the exact ids."""
    with OpenEXR.File(path, separate_channels=True) as file:
        header, channels = file.header(), file.channels()
        key = f"cryptomatte/{mmh3.hash(layer, signed=False):08x}"[: len("cryptomatte/") + 7]
        found = {name: header[f"{key}/{name}"] for name in ("name", "hash", "conversion")}
        assert found == {"name": layer, "hash": "MurmurHash3_32", "conversion": "uint32_to_float32"}, found
        manifest = json.loads(header[f"{key}/manifest"])
        names = [f"{layer}{number:02}.{letter}" for number in range(RANKS // 2) for letter in "RGBA"]
        pixels = [channels[name].pixels for name in names]
        assert all(p.dtype == numpy.float32 for p in pixels)
        exact = numpy.array(channels[LAYERS[layer]].pixels)
    ids = numpy.stack(pixels[0::2], axis=-1).view(numpy.uint32)
    return ids, numpy.stack(pixels[1::2], axis=-1), manifest, exact


def check_file(path, layer, samples):
    """The rules of the specification, for one file."""
    ids, coverage, manifest, exact = read(path, layer)
    assert manifest and all(int(hexed, 16) == bits(name) for name, hexed in manifest.items())
    assert all(len(hexed) == 8 for hexed in manifest.values())
    known = numpy.array([int(hexed, 16) for hexed in manifest.values()], numpy.uint32)
    assert numpy.isin(ids[coverage > 0], known).all(), "an id is not in the manifest"
    assert (ids[coverage == 0] == 0).all(), "an id has no coverage"
    assert (numpy.diff(coverage, axis=-1) <= 0).all(), "ranks are not sorted"
    assert (coverage.sum(axis=-1) <= 1 + 1e-6).all() and (coverage >= 0).all()
    counts = coverage * samples
    assert numpy.abs(counts - counts.round()).max() < 1e-4, "coverage is no number of samples"
    # What is in the exact ids is the first sample's, and so it has coverage.
    whole = coverage[..., 0] > 1 - 1e-6
    pairs = set(zip(exact[whole].tolist(), ids[..., 0][whole].tolist()))
    names = dict(pairs)
    assert len(pairs) == len(names) == len(set(names.values())), "whole pixels disagree with the exact ids"
    assert 0 not in names, "nothing has coverage"
    expected = numpy.array([names.get(i, 0) for i in range(exact.max() + 1)], numpy.uint32)[exact]
    among = (ids == expected[..., None]).any(axis=-1) | (expected == 0)
    assert among.all(), "a pixel's exact id has no coverage"
    return ids, coverage, manifest


def check_coverage(layer, many, large):
    """Coverage is a mean over the pixel's area, as that of a larger image, within the noise of samples."""
    ids, coverage, manifest = many
    large_ids, large_coverage, _ = large
    factor = large_ids.shape[0] // ids.shape[0]
    worst = squares = 0.0
    for hexed in manifest.values():
        ours = (coverage * (ids == int(hexed, 16))).sum(axis=-1)
        theirs = (large_coverage * (large_ids == int(hexed, 16))).sum(axis=-1)
        theirs = theirs.reshape(ids.shape[0], factor, ids.shape[1], factor).mean(axis=(1, 3))
        worst = max(worst, abs(ours.mean() - theirs.mean()))
        squares += ((ours - theirs) ** 2).sum(axis=None)
    error = (squares / ids[..., 0].size) ** 0.5
    partial = (coverage[..., 0] < 1 - 1e-6).mean()
    print(f"  {layer}: {len(manifest)} names, {partial:.0%} of the pixels show several;", end=" ")
    print(f"mean coverage differs by {worst:.4f} at most, that of a pixel by {error:.3f}")
    assert worst < 0.001 and error < 0.06 and partial > 0.1


def check_reader(path):
    """An independent reader finds the same names and masks."""
    mattes = {matte.metadata().name(): matte for matte in Cryptomatte.load(path)}
    for layer in LAYERS:
        ids, coverage, manifest, _ = read(path, layer)
        masks = mattes[layer].masks()
        shown = 0
        for name, hexed in manifest.items():
            ours = (coverage * (ids == int(hexed, 16))).sum(axis=-1)
            if ours.any():
                shown += 1
                theirs = numpy.array(mattes[layer].mask(name)).reshape(ours.shape)
                assert numpy.abs(ours - theirs).max() < 1e-6, f"{name}: the masks differ"
        assert shown > 5 and len(masks) >= shown


def main():
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    many, one, large = sys.argv[1:]
    for layer in LAYERS:
        check_file(one, layer, 1)
        check_coverage(layer, check_file(many, layer, 16), check_file(large, layer, 1))
    check_reader(many)


main()
