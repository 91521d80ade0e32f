"""What EndoGaussian rendered of a film, as a prediction.

    python endogaussian_row.py DIR

DIR/endonerf/EXPORT.md says where the film lies on the canvas of 640x512 pixels that EndoGaussian's loader wants;
DIR/renders holds NNNNN.png of every frame; DIR/seconds.txt what both programs took: wall, user and system seconds.
"""

import argparse
import json
import pathlib
import re
import shutil

from PIL import Image

METHOD = "endogaussian-true-depth"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=pathlib.Path)
    folder = parser.parse_args().folder
    export = (folder / "endonerf/EXPORT.md").read_text().replace("\n", " ")
    width, height, left, top = map(
        int, re.search(r"the film's (\d+)x(\d+) pixels begin at column (\d+), row (\d+)", export).groups()
    )
    # Its own numbers begin at 0 and have five digits.
    names = sorted(path.stem for path in (folder / "endonerf/images").glob("*.png"))

    # All of the prediction or nothing.
    part = folder / ".unfinished-prediction"
    shutil.rmtree(part, ignore_errors=True)
    (part / "color").mkdir(parents=True)
    for number, name in enumerate(names):
        canvas = Image.open(folder / f"renders/{number:05}.png").convert("RGB")
        canvas.crop((left, top, left + width, top + height)).save(part / f"color/{name}.png")
    spent = folder / "seconds.txt"
    if spent.exists():
        wall, user, system = map(float, spent.read_text().split()[-3:])
        (part / "timing.json").write_text(json.dumps({"time_total_s": wall, "time_cpu_s": user + system}))
    (part / "prediction.json").write_text(json.dumps({"method": METHOD}))
    part.rename(folder / "prediction")


if __name__ == "__main__":
    main()
