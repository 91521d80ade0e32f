"""The examples do what their first lines say."""

import os
import re
import subprocess
import sys
import tempfile
import unittest

from support import EXAMPLES, PROGRAM, films, needs, torch


def run(name, *arguments):
    script = os.path.join(EXAMPLES, name)
    return subprocess.run([sys.executable, script, *arguments], capture_output=True, text=True, check=True).stdout


@needs(PROGRAM, "the program respire-bench is not there, so that no example has a film")
class Examples(unittest.TestCase):
    def test_an_own_method_from_film_to_scored_row(self):
        with open(os.path.join(EXAMPLES, "own_method.py")) as file:
            lines = file.read().splitlines()
        self.assertLessEqual(len(lines), 40)
        with tempfile.TemporaryDirectory() as place:
            said = run("own_method.py", films(), os.path.join(place, "answer"))
        row = dict(line.split(None, 1) for line in said.splitlines() if len(line.split(None, 1)) == 2)
        self.assertEqual(row["method"], "painted-mesh")
        self.assertGreater(float(row["psnr_db"]), 15)
        self.assertLess(float(row["depth_rmse_mm"]), 5)
        self.assertIn("phase_mae", row)

    @needs(torch, "torch cannot be imported here, so that the example of training does not run")
    def test_free_gaussians_are_trained_on_a_frame(self):
        said = run("train_gaussians.py", os.path.join(films(), "participant"), "60")
        first, last = (float(db) for db in re.findall(r"([\d.]+) dB", said))
        self.assertGreater(last, first + 3)
        self.assertGreater(last, 24)


if __name__ == "__main__":
    unittest.main()
