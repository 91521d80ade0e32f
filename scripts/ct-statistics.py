#!/usr/bin/env python3
"""Compares CT volumes: HU of the lungs, spectrum of the noise, sharpness of edges; draws slices in the lung window.

    scripts/ct-statistics.py [--pictures DIR] VOLUME..      (.nii, .nii.gz, .mha; needs numpy, scipy, pillow)
"""

import argparse
import gzip
import pathlib
import zlib

import numpy
from scipy import ndimage


def read_metaimage(path):
    data, header, start = path.read_bytes(), {}, 0
    while "ElementDataFile" not in header:
        end = data.index(b"\n", start)
        key, value = data[start:end].decode().split("=", 1)
        header[key.strip()], start = value.strip(), end + 1
    body = data[start:]
    if header.get("CompressedData") == "True":
        body = zlib.decompress(body)
    kind = {"MET_SHORT": "<i2", "MET_UCHAR": "u1", "MET_FLOAT": "<f4"}[header["ElementType"]]
    size = [int(n) for n in header["DimSize"].split()]
    spacing = [float(n) for n in header["ElementSpacing"].split()]
    return numpy.frombuffer(body, kind).reshape(size[::-1]), spacing


def read_nifti(path):
    data = path.read_bytes()
    data = gzip.decompress(data) if path.suffix == ".gz" else data
    size = numpy.frombuffer(data[42:48], "<i2")
    spacing = numpy.frombuffer(data[80:92], "<f4")
    kind = {4: "<i2", 2: "u1", 16: "<f4"}[int(numpy.frombuffer(data[70:72], "<i2")[0])]
    volume = numpy.frombuffer(data[352:], kind, int(numpy.prod(size, dtype=int)))
    return volume.reshape(size[::-1]), [float(s) for s in spacing]


def read(path):
    return read_metaimage(path) if path.suffix == ".mha" else read_nifti(path)


def lungs_of(volume, spacing):
    """Air inside of the body, 3 mm off its rim."""
    air = volume < -400
    labels, count = ndimage.label(air)
    rim = set(numpy.unique(labels[:, 0, :])) | set(numpy.unique(labels[:, -1, :]))
    rim |= set(numpy.unique(labels[:, :, 0])) | set(numpy.unique(labels[:, :, -1]))
    sizes = numpy.bincount(labels.ravel(), minlength=count + 1)
    litres = sizes * numpy.prod(spacing) * 1e-6
    inner = [n for n in range(1, count + 1) if n not in rim and litres[n] > 0.15]
    # A scan of half a chest is cropped through the lung.
    kept = inner or [int(sizes[1:].argmax()) + 1]
    lungs = ndimage.binary_closing(numpy.isin(labels, kept), iterations=2)
    return ndimage.distance_transform_edt(lungs, spacing[::-1]) > 3.0


def noise_of(volume, spacing, low=0, high=120, side=16):
    """Standard deviation in even soft tissue, and the spectrum's mean frequency in the plane, 1/mm."""
    blocks = []
    for z in range(0, volume.shape[0], 3):
        for y in range(0, volume.shape[1] - side, side // 2):
            for x in range(0, volume.shape[2] - side, side // 2):
                block = volume[z, y : y + side, x : x + side].astype(float)
                if low < block.mean() < high and block.min() > -150 and block.max() < 260:
                    blocks.append(block - block.mean())
    if not blocks:
        return None
    blocks.sort(key=lambda b: b.std())
    even = blocks[: max(1, len(blocks) // 4)]
    window = numpy.hanning(side)[:, None] * numpy.hanning(side)[None, :]
    power = sum(numpy.abs(numpy.fft.fft2(b * window)) ** 2 for b in even)
    f = numpy.fft.fftfreq(side, spacing[0])
    radius = numpy.hypot(f[:, None], f[None, :])
    power[0, 0] = 0
    deviation = numpy.median([b.std() for b in even])
    return deviation, float((power * radius).sum() / power.sum()), len(even)


def picture(volume, spacing, path):
    from PIL import Image

    def windowed(plane, aspect):
        grey = numpy.clip((plane + 1350.0) / 1500.0 * 255, 0, 255).astype(numpy.uint8)
        image = Image.fromarray(grey)
        return image.resize((plane.shape[1], max(1, round(plane.shape[0] * aspect))), Image.BILINEAR)

    z, y, x = volume.shape
    planes = [windowed(volume[int(z * f)], 1.0) for f in (0.3, 0.5, 0.7)]
    planes.append(windowed(volume[::-1, int(y * 0.52)], spacing[2] / spacing[0]))
    planes.append(windowed(volume[::-1, :, int(x * 0.3)], spacing[2] / spacing[0]))
    height = max(p.height for p in planes)
    sheet = Image.new("L", (sum(p.width for p in planes), height))
    at = 0
    for plane in planes:
        sheet.paste(plane, (at, 0))
        at += plane.width
    sheet.save(path)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("volumes", nargs="+", type=pathlib.Path)
    parser.add_argument("--pictures", type=pathlib.Path)
    arguments = parser.parse_args()
    print("| volume | voxels, mm | lungs, HU: 5 % / median / mean / 95 % | texture 2 to 8 mm, HU | noise, HU; 1/mm |")
    print("|---|---|---|---|---|")
    for path in arguments.volumes:
        volume, spacing = read(path)
        volume = numpy.maximum(volume.astype(numpy.int16), -1024)
        lungs = lungs_of(volume, spacing)
        inside = volume[lungs]
        low, middle, high = numpy.percentile(inside, [5, 50, 95])
        scale = numpy.array(spacing[::-1])
        smooth = [ndimage.gaussian_filter(volume.astype(numpy.float32), mm / 2.0 / scale) for mm in (2.0, 8.0)]
        texture = (smooth[0] - smooth[1])[lungs].std()
        noise = noise_of(volume, spacing)
        said = f"{noise[0]:.0f}; {noise[1]:.2f}" if noise else ""
        size = " x ".join(f"{s:.2f}" for s in spacing)
        print(f"| {path.name} | {size} | {low:.0f} / {middle:.0f} / {inside.mean():.0f} / {high:.0f} | {texture:.0f} | {said} |")
        if arguments.pictures:
            arguments.pictures.mkdir(parents=True, exist_ok=True)
            picture(volume, spacing, arguments.pictures / f"{path.parent.name}-{path.name.split('.')[0]}.png")


if __name__ == "__main__":
    main()
