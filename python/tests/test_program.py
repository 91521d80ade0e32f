"""`evaluate` and `export`, through the real program."""

import os
import pickle
import subprocess
import sys
import tempfile
import unittest
from unittest import mock

import numpy as np

from respire_bench import ProgramFailed, ProgramMissing, evaluate, export, load, write_prediction
from support import PROGRAM, films, needs


def has_export():
    return PROGRAM and subprocess.run([PROGRAM, "export", "--help"], capture_output=True).returncode == 0


class Missing(unittest.TestCase):
    def test_the_cure_is_said(self):
        with mock.patch.dict(os.environ, {"PATH": "/nonexistent"}):
            os.environ.pop("RESPIRE_BENCH", None)
            with self.assertRaisesRegex(ProgramMissing, "cargo build --release"):
                evaluate("film", "prediction")
        with mock.patch.dict(os.environ, {"RESPIRE_BENCH": "/nonexistent/program"}):
            with self.assertRaisesRegex(ProgramMissing, "RESPIRE_BENCH is /nonexistent/program"):
                export("film", "tum", "out")


class Said(unittest.TestCase):
    """What a program that is none of ours says, and is told."""

    def run_script(self, lines, call):
        with tempfile.TemporaryDirectory() as place:
            script = os.path.join(place, "program")
            with open(script, "w") as file:
                file.write("\n".join([f"#!{sys.executable}", "import sys", *lines]))
            os.chmod(script, 0o755)
            with mock.patch.dict(os.environ, {"RESPIRE_BENCH": script}):
                return call()

    def failed(self, said):
        with self.assertRaises(ProgramFailed) as caught:
            self.run_script([f"sys.stderr.write({said!r})", "sys.exit(3)"], lambda: evaluate("film", "answer"))
        return caught.exception

    def test_the_sentence_is_the_last_error(self):
        for said, sentence in (
            ("note\nerror: a\n\nerror: no 'x'\n  [possible: y, z]\n\nUsage: u\n\nmore\n", "no 'x' [possible: y, z]"),
            ("error: the film is\ndamaged", "the film is damaged"),
            ("Killed: 9\n\n", "Killed: 9"),
            ("", "respire-bench evaluate failed without a word"),
        ):
            self.assertEqual(str(self.failed(said)), sentence)

    def test_a_failure_goes_to_another_process(self):
        failed = self.failed("error: nothing is there")
        copy = pickle.loads(pickle.dumps(failed))
        self.assertEqual((str(copy), copy.exit_code, copy.args), ("nothing is there", 3, failed.args))

    def test_values_that_look_like_options_are_none(self):
        lines = ["sys.stderr.write('error: ' + '|'.join(sys.argv[1:]))", "sys.exit(1)"]
        for call, wanted in (
            (
                lambda: evaluate("-film", "answer", method="-x", out="-o", threads=2),
                "evaluate|--json|--sequence=./-film|--predictions=answer|--method=-x|--out=./-o|--threads=2",
            ),
            (
                lambda: export("-f", "tum", "o", scale=-1.0, threads=0),
                "export|./-f|--format=tum|--out=o|--scale=-1.0|--threads=0",
            ),
            (
                lambda: export("f", "endonerf", "o", truth=True, axes="opencv"),
                "export|f|--truth|--format=endonerf|--out=o|--axes=opencv",
            ),
        ):
            with self.assertRaises(ProgramFailed) as caught:
                self.run_script(lines, call)
            self.assertEqual(str(caught.exception), wanted)


@needs(PROGRAM, "the program respire-bench is not there, so that nothing is scored")
class Scoring(unittest.TestCase):
    def test_a_prediction_becomes_a_dict_and_a_row(self):
        film = load(os.path.join(films(), "truth"), truth=True)
        with tempfile.TemporaryDirectory() as place:
            answer = os.path.join(place, "answer")
            noisy = np.asarray(film.images).astype(int) + np.random.default_rng(0).integers(-20, 21, (9, 48, 48, 3))
            write_prediction(
                answer, film, np.clip(noisy, 0, 255).astype(np.uint8), depth_mm=film.depths_mm, method="noise"
            )
            scores, row = evaluate(film, answer)
            self.assertEqual((row["case"], row["method"], row["frames"]), ("case4", "noise", 9))
            # Noise of variance 140 in codes; clipping makes it a little less.
            self.assertAlmostEqual(row["psnr_db"], 10 * np.log10(255**2 / 140), delta=1.5)
            self.assertEqual(scores["psnr_db"]["status"], "ok")
            self.assertIsNone(row["phase_mae"])
            self.assertEqual(scores["phase_mae"]["status"], "not_applicable")
            self.assertEqual(evaluate(film.folder, answer, method="-other", threads=1)[1]["method"], "-other")
            with self.assertRaises(ProgramFailed) as caught:
                evaluate(film, os.path.join(place, "nothing"))
            self.assertEqual(caught.exception.exit_code, 4)
            self.assertIn("nothing", str(caught.exception))


@needs(has_export() or None, "this respire-bench has no command `export`, so that nothing is exported")
class Exporting(unittest.TestCase):
    def test_a_film_in_another_layout(self):
        with tempfile.TemporaryDirectory() as place:
            out = export(load(os.path.join(films(), "truth")), "tum", os.path.join(place, "tum"))
            self.assertTrue(any(len(files) for _, _, files in os.walk(out)))
            with self.assertRaisesRegex(ProgramFailed, "^invalid value 'no-such-layout'.*colmap"):
                export(films(), "no-such-layout", os.path.join(place, "no"))

    def test_axes_are_those_that_are_asked_for(self):
        film = os.path.join(films(pinhole=True), "truth")
        with tempfile.TemporaryDirectory() as place:
            rotations = {}
            for axes in (None, "opengl", "opencv"):
                out = export(film, "endonerf", os.path.join(place, str(axes)), truth=True, axes=axes)
                poses = np.load(os.path.join(out, "poses_bounds.npy"))[:, :15].reshape(-1, 3, 5)
                rotations[axes] = poses[:, :, :3]
            np.testing.assert_array_equal(rotations[None], rotations["opengl"])
            np.testing.assert_array_equal(rotations["opengl"] * [1, -1, -1], rotations["opencv"])
            with self.assertRaisesRegex(ProgramFailed, "axes"):
                export(film, "tum", os.path.join(place, "no"), axes="opencv")


if __name__ == "__main__":
    unittest.main()
