"""`load` and `write_prediction`, on a film that the program makes."""

import inspect
import json
import multiprocessing
import os
import pickle
import shutil
import tempfile
import unittest

import numpy as np

from respire_bench import Error, ProgramFailed, evaluate, load, write_prediction
from support import PROGRAM, films, forked, needs, program, torch

KEPT = (
    "poses times_s K fisheye targets_mm phases gains targets_expiration_mm targets_by_frame_mm true_poses true_fisheye"
).split()
"""Names of a film's arrays that are read once."""


@needs(PROGRAM, "the program respire-bench is not there, so that no film can be made to read")
class Reading(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.participant = load(os.path.join(films(), "participant"))
        cls.film = load(os.path.join(films(), "truth"))
        cls.truth = load(os.path.join(films(), "truth"), truth=True)

    def test_both_folders_give_a_method_the_same(self):
        a, b = self.participant, self.film
        self.assertEqual((len(a), a.width, a.height), (9, 48, 48))
        for name in ("poses", "times_s", "K", "fisheye", "mask", "centerline_mm", "targets_mm", "novel_poses"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)
        np.testing.assert_array_equal(a.images, b.images)
        np.testing.assert_array_equal(a.depths_mm[0], b.depths_mm[0])
        for name in ("inspiration", "expiration"):
            for ours, theirs in zip(getattr(a, name), getattr(b, name)):
                np.testing.assert_array_equal(ours, theirs)
        self.assertEqual((a.novel_frames, a.held_out_frames), ([7], [7]))
        self.assertEqual(a.breathing_period_s, b.breathing_period_s)

    def test_arrays_have_their_types_and_shapes(self):
        film = self.participant
        self.assertEqual((film.images.shape, film.images.dtype), ((9, 48, 48, 3), np.uint8))
        self.assertEqual((film.images[2:5].shape, film.images[-1].shape), ((3, 48, 48, 3), (48, 48, 3)))
        self.assertEqual((film.depths_mm.shape, film.depths_mm[0].dtype), ((1, 48, 48), np.float32))
        self.assertEqual((film.poses.shape, film.times_s.shape), ((9, 4, 4), (9,)))
        frame = film[-1]
        self.assertEqual((frame.index, frame.time_s), (8, film.times_s[8]))
        np.testing.assert_array_equal(frame.image, film.images[8])
        self.assertEqual(len(list(film)), 9)
        vertices, faces = film.inspiration
        self.assertEqual((vertices.dtype, faces.dtype, faces.shape[1]), (np.float64, np.uint32, 3))
        self.assertLess(faces.max(), len(vertices))
        self.assertGreater(np.asarray(film.images).std(), 5)

    def test_poses_are_opencvs(self):
        # The depth of frame 0 lies on the surface at its phase, a few hundredths of a millimetre coarse.
        film = self.truth
        depth, pose, k = film.depths_mm[0], film.poses[0], film.fisheye
        self.assertIsNotNone(k, "case4 is filmed by a wide-angle scope")
        v, u = np.argwhere((depth > 0) & (depth < 20))[::37].T
        x, y = (u + 0.5 - film.K[0, 2]) / film.K[0, 0], (v + 0.5 - film.K[1, 2]) / film.K[1, 1]
        distorted = np.hypot(x, y)
        theta = distorted.copy()
        for _ in range(50):
            t2 = theta**2
            theta = distorted / (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
        scale = np.tan(theta) / np.maximum(distorted, 1e-12)
        rays = np.stack([x * scale, y * scale, np.ones_like(x)], -1)
        points = (rays * depth[v, u, None]) @ pose[:3, :3].T + pose[:3, 3]
        vertices, faces = film.meshes[0]
        nearest = np.sqrt(((points[:, None] - vertices[faces].mean(1)[None]) ** 2).sum(-1).min(1))
        self.assertLess(np.median(nearest), 0.5)

    def test_the_truth_stays_shut(self):
        for film in (self.participant, self.film):
            for name in (
                "phases",
                "gains",
                "case",
                "targets_expiration_mm",
                "targets_by_frame_mm",
                "true_poses",
                "true_novel_poses",
                "true_K",
                "true_fisheye",
                "true_inspiration",
                "true_expiration",
            ):
                with self.assertRaisesRegex(Error, "is truth"):
                    getattr(film, name)
            for read in (lambda: film.meshes[0], lambda: film.novel_images[0], lambda: film.novel_depths_mm[0]):
                with self.assertRaisesRegex(Error, "is truth"):
                    read()
            with self.assertRaisesRegex(IndexError, r"depths_mm\[1\].*truth=True\) opens the others"):
                film.depths_mm[1]
            with self.assertRaisesRegex(Error, "is truth"):
                film._film.depth_mm(1)
        with self.assertRaisesRegex(Error, "holds no truth"):
            load(self.participant.folder, truth=True)

    def test_a_film_can_be_looked_through_without_its_truth(self):
        self.assertFalse(hasattr(self.film, "phases"))
        self.assertIsNone(getattr(self.film, "meshes", None))
        names = [name for name, _ in inspect.getmembers(self.film)]
        self.assertIn("poses", names)
        self.assertNotIn("true_poses", names)

    def test_what_a_film_holds_cannot_be_written_over(self):
        film = load(self.truth.folder, truth=True)
        arrays = {name: getattr(film, name) for name in KEPT}
        arrays |= {"surface": film.inspiration.vertices, "faces": film.true_expiration.faces}
        for name, array in arrays.items():
            with self.assertRaisesRegex(ValueError, "read-only", msg=name):
                array *= 2
        film[0].pose[:] = 0
        np.testing.assert_array_equal(film[0].pose, self.truth.poses[0])

    def test_a_film_stays_the_same_after_a_change_of_directory(self):
        folder, before = os.path.relpath(self.truth.folder), os.getcwd()
        film = load(folder)
        try:
            os.chdir(tempfile.gettempdir())
            np.testing.assert_array_equal(pickle.loads(pickle.dumps(film)).images[3], self.truth.images[3])
        finally:
            os.chdir(before)

    def test_the_truth(self):
        film = self.truth
        self.assertEqual((film.case, film.phases.shape, film.depths_mm.shape), ("case4", (9,), (9, 48, 48)))
        self.assertEqual(film.targets_expiration_mm.shape, film.targets_mm.shape)
        self.assertGreater(np.ptp(film.phases), 0.01)
        self.assertEqual((film.novel_images.shape, film.novel_depths_mm[0].shape), ((1, 48, 48, 3), (48, 48)))
        a = film.phases[3]
        wanted = (1 - a) * film.inspiration.vertices + a * film.expiration.vertices
        np.testing.assert_allclose(film.meshes[3].vertices, wanted, atol=1e-9)

    def test_the_truth_is_what_is_told_on_the_ideal_track(self):
        film = self.truth
        for told, true in (("poses", "true_poses"), ("K", "true_K"), ("novel_poses", "true_novel_poses")):
            np.testing.assert_array_equal(getattr(film, told), getattr(film, true), told)
        np.testing.assert_array_equal(film.fisheye, film.true_fisheye)
        a = film.phases[:, None, None]
        wanted = (1 - a) * film.targets_mm + a * film.targets_expiration_mm
        np.testing.assert_allclose(film.targets_by_frame_mm, wanted, atol=1e-9)
        np.testing.assert_array_equal(film.true_inspiration.vertices, film.inspiration.vertices)

    def test_what_is_no_film_is_named(self):
        with tempfile.TemporaryDirectory() as folder:
            with self.assertRaisesRegex(Error, "no manifest.json"):
                load(folder)
        with self.assertRaisesRegex(Error, "there is no such folder"):
            load("/nonexistent/film")
        for wrong, said in (
            (lambda: self.film[9], "frame 9 of a film of 9 frames"),
            (lambda: self.film.images[-10], r"images\[-10\]: the film has 9 frames"),
            (lambda: self.truth.novel_images[1], r"novel_images\[1\]: the frames with a second camera are \[7\]"),
            (lambda: self.truth.meshes[9], "frame 9 of a film of 9 frames"),
        ):
            with self.assertRaisesRegex(IndexError, said):
                wrong()

    def test_films_are_sequences(self):
        film = self.truth
        self.assertEqual([frame.index for frame in film[6:3:-1]], [6, 5, 4])
        self.assertEqual(film[9:], [])
        for frames in (film, film.meshes):
            self.assertTrue(hasattr(type(frames), "__iter__"))
        self.assertEqual(len(list(film.meshes)), 9)
        self.assertEqual((film.images.ndim, film.depths_mm.ndim), (4, 3))
        np.testing.assert_array_equal(film.meshes[8:6:-1][1].vertices, film.meshes[7].vertices)
        if np.lib.NumpyVersion(np.__version__) >= "2.0.0":
            with self.assertRaisesRegex(ValueError, "without a copy"):
                np.asarray(film.images, copy=False)

    def test_films_go_to_other_processes(self):
        copy = pickle.loads(pickle.dumps(self.truth))
        self.assertEqual((copy.folder, copy.truth), (self.truth.folder, True))
        np.testing.assert_array_equal(copy.phases, self.truth.phases)
        for lazy in (self.truth.images, self.truth.depths_mm, self.truth.novel_images, self.truth.novel_depths_mm):
            np.testing.assert_array_equal(pickle.loads(pickle.dumps(lazy)), lazy)
        meshes = pickle.loads(pickle.dumps(self.truth.meshes))
        np.testing.assert_array_equal(meshes[3].vertices, self.truth.meshes[3].vertices)

    def test_a_forked_child_reads(self):
        wanted = self.truth.depths_mm[3]

        def read():
            np.testing.assert_array_equal(self.truth.depths_mm[3], wanted)
            np.testing.assert_array_equal(load(self.truth.folder).images[3], self.truth.images[3])
            return len(self.truth.meshes[3].faces)

        self.assertEqual(forked(read), len(self.truth.meshes[3].faces))

    @needs(torch, "torch cannot be imported here, so that no DataLoader reads a film")
    def test_a_dataloader_with_workers_reads(self):
        self.truth.depths_mm[0]
        how = {"num_workers": 2, "multiprocessing_context": multiprocessing.get_context("fork"), "timeout": 60}
        loader = torch.utils.data.DataLoader(self.truth.depths_mm, batch_size=3, **how)
        np.testing.assert_array_equal(torch.cat(list(loader)), self.truth.depths_mm)


@needs(PROGRAM, "the program respire-bench is not there, so that no film can be made to read")
class Clinical(unittest.TestCase):
    """A film whose cameras and surfaces are told otherwise than they are, and whose tissue moves beyond the breath."""

    def setUp(self):
        self.folder = os.path.join(films(clinical=True), "truth")
        self.film = load(self.folder, truth=True)

    def test_the_truth_is_not_what_is_told(self):
        film, told = self.film, load(self.folder)
        np.testing.assert_array_equal(film.poses, told.poses)
        np.testing.assert_array_equal(film.K, told.K)
        with open(os.path.join(self.folder, "transforms.json")) as file:
            written = json.load(file)
        true = np.array([frame["transform_matrix"] for frame in written["frames"]]) * [1, -1, -1, 1]
        np.testing.assert_allclose(film.true_poses, true, atol=1e-12)
        wanted = [[written["fl_x"], 0, written["cx"]], [0, written["fl_y"], written["cy"]], [0, 0, 1]]
        np.testing.assert_array_equal(film.true_K, wanted)
        self.assertGreater(np.abs(film.poses[:, :3, 3] - film.true_poses[:, :3, 3]).max(), 0.1)
        self.assertGreater(np.abs(film.K - film.true_K).max(), 1e-3)
        self.assertEqual(film.true_novel_poses.shape, film.novel_poses.shape)
        self.assertFalse(np.array_equal(film.true_novel_poses, film.novel_poses))
        self.assertEqual(film.true_inspiration.faces.shape, film.true_expiration.faces.shape)

    def test_targets_are_where_the_film_has_them(self):
        rows = np.loadtxt(os.path.join(self.folder, "targets_by_frame.csv"), delimiter=",", skiprows=1)
        film = self.film
        np.testing.assert_array_equal(film.targets_by_frame_mm, rows[:, 2:].reshape(len(film), -1, 3))
        a = film.phases[:, None, None]
        blend = (1 - a) * film.targets_mm + a * film.targets_expiration_mm
        self.assertGreater(np.abs(film.targets_by_frame_mm - blend).max(), 0.05)

    def test_the_wall_is_known_at_the_last_frame_alone(self):
        meshes, film = self.film.meshes, self.film
        np.testing.assert_array_equal(meshes[-1].vertices, meshes[len(film) - 1].vertices)
        a = film.phases[-1]
        blend = (1 - a) * film.true_inspiration.vertices + a * film.true_expiration.vertices
        self.assertGreater(np.abs(meshes[-1].vertices - blend).max(), 0.05)
        for frame in (0, 3, len(film) - 2):
            with self.assertRaisesRegex(Error, rf"meshes\[{frame}\]: the film is of the clinical track"):
                meshes[frame]


@needs(PROGRAM, "the program respire-bench is not there, so that no prediction can be checked")
class Writing(unittest.TestCase):
    def setUp(self):
        self.film = load(os.path.join(films(), "participant"))
        place = tempfile.TemporaryDirectory()
        self.addCleanup(place.cleanup)
        self.place = place.name
        self.folder = os.path.join(place.name, "answer")

    def test_everything_is_read_back_by_the_program(self):
        film, r = self.film, np.random.default_rng(0)
        images = r.uniform(0, 1, (9, 48, 48, 3))
        depths = r.uniform(1, 30, (9, 48, 48))
        write_prediction(
            self.folder,
            film,
            (image for image in images),
            depth_mm=depths,
            ahead={7: images[7]},
            novel=[(images[0] * 255).astype(np.uint8)],
            novel_depth_mm=depths[:1],
            phase=np.linspace(0, 1, 9),
            phase_sd=np.full(9, 0.1),
            poses=film.poses,
            targets_mm=np.stack([film.targets_mm] * 9),
            target_covariance_mm2=np.tile([[4, 1, 0], [1, 2, -0.5], [0, -0.5, 3]], (9, len(film.targets_mm), 1, 1)),
            mesh=film.inspiration,
            method="random",
            time_total_s=2.5,
            time_cpu_s=3.5,
        )
        checked = program("check", self.folder, "--sequence", film.folder)
        self.assertIn("9 frames", checked)
        said = {}
        for name in ("prediction.json", "timing.json"):
            with open(os.path.join(self.folder, name)) as file:
                said[name] = json.load(file)
        self.assertEqual(said["prediction.json"]["method"], "random")
        self.assertEqual((said["timing.json"]["time_total_s"], said["timing.json"]["time_cpu_s"]), (2.5, 3.5))
        rows = np.loadtxt(os.path.join(self.folder, "phase.csv"), delimiter=",", skiprows=1)
        np.testing.assert_allclose(rows[:, 1], np.linspace(0, 1, 9), atol=1e-9)
        rows = np.loadtxt(os.path.join(self.folder, "target_covariance.csv"), delimiter=",", skiprows=1)
        np.testing.assert_array_equal(rows[0], [0, 0, 4, 1, 0, 2, -0.5, 3])

    def test_a_dict_in_any_order(self):
        images = np.zeros((9, 48, 48, 3), np.uint8)
        poses = {i: self.film.poses[i] for i in reversed(range(9))}
        write_prediction(self.folder, self.film, dict(enumerate(images)), poses=poses)
        program("check", self.folder, "--sequence", self.film.folder)

    def test_pictures_alone_are_enough(self):
        write_prediction(self.folder, self.film, np.zeros((9, 48, 48, 3), np.uint8))
        self.assertEqual(os.listdir(self.folder), ["color"])
        program("check", self.folder, "--sequence", self.film.folder)

    def refused(self, word, *color, **wrong):
        try:
            write_prediction(self.folder, self.film, *(color or [np.zeros((9, 48, 48, 3), np.uint8)]), **wrong)
        except Error as error:
            # With its traceback, as a notebook keeps the last one. `assertRaises` would clear its frames.
            kept = error
        else:
            self.fail(f"nothing was refused: {word}")
        self.assertRegex(str(kept), f"^{word}")
        self.assertNotIn("\n", str(kept))
        self.assertFalse(os.path.exists(self.folder))
        self.assertEqual(os.listdir(self.place), [])

    def test_what_is_wrong_is_named_and_leaves_nothing(self):
        self.refused("color: has 8 values, 9 are wanted", np.zeros((8, 48, 48, 3), np.uint8))
        self.refused("color: has more than the 9", np.zeros((10, 48, 48, 3), np.uint8))
        self.refused("color, frame 0: has shape", np.zeros((9, 48, 40, 3), np.uint8))
        self.refused("color, frame 0: wanted 8-bit", np.zeros((9, 48, 48, 3), np.int64))
        self.refused("depth_mm, frame 0", depth_mm=np.zeros((9, 4, 4)))
        far = np.full((9, 48, 48), 1e6, np.float32)
        far[5, 2, 3] = 1e7
        self.refused(r"depth_mm, frame 5: pixel \(3, 2\): .* must lie in 0 to 1000000", depth_mm=far)
        self.refused("ahead: wanted the frames", ahead={6: np.zeros((48, 48, 3))})
        self.refused("ahead: wanted the frames", ahead={6: np.zeros((48, 48, 3)), "7": None})
        with self.assertRaisesRegex(Error, "film: wanted what load"):
            write_prediction(self.folder, self.film.folder, np.zeros((9, 48, 48, 3), np.uint8))
        self.refused("color: is None", None)
        self.refused("color: wanted a value for each of 9 frames, not 3", 3)
        self.refused("color, frame 0: has inf; floats are in 0..1", np.full((9, 48, 48, 3), np.inf))
        self.refused("color, frame 0: has 255; floats are in 0..1", np.full((9, 48, 48, 3), 255.0))
        self.refused("phase, frame 2", phase=[0, 0, np.nan, 0, 0, 0, 0, 0, 0])
        self.refused(r"phase, frame 0: has shape \(1,\)", phase=np.zeros((9, 1)))
        self.refused("phase, frame 0: wanted numbers, not None", phase=[None] * 9)
        self.refused("phase, frame 0: is no array", phase=[[1, [2]]] * 9)
        self.refused("phase_sd: wanted a value for each", phase=np.ones(9), phase_sd=0.1)
        self.refused("phase_sd", phase_sd=np.ones(9))
        self.refused("phase, frame 0: 2000 must lie in -1000 to 1000", phase=np.full(9, 2000))
        self.refused("phase_sd, frame 0: 0 must lie in", phase=np.ones(9), phase_sd=np.zeros(9))
        self.refused("poses, frame 0: has another last row", poses=np.zeros((9, 4, 4)))
        far = self.film.poses.copy()
        far[2, 0, 3] = 20000
        self.refused("poses, frame 2: lies too far away", poses=far)
        self.refused("targets_mm, frame 0", targets_mm=np.zeros((9, 1, 3)))
        places = np.stack([self.film.targets_mm] * 9)
        for wrong in (20000, np.nan):
            far = places.copy()
            far[3, 1, 2] = wrong
            self.refused("targets_mm, frame 3: point 1: .* must lie in -10000 to 10000", targets_mm=far)
        spread = np.tile(np.eye(3), (9, places.shape[1], 1, 1))
        self.refused("target_covariance_mm2: is given without targets_mm", target_covariance_mm2=spread)
        for k, wrong in (((0, 0), -1), ((0, 1), 0.5), ((2, 2), 1e-10), ((1, 1), 1e9), ((1, 1), np.nan)):
            bad = spread.copy()
            bad[(4, 1, *k)] = wrong
            word = "target_covariance_mm2, frame 4: that of target 1"
            self.refused(word, targets_mm=places, target_covariance_mm2=bad)
        self.refused("mesh: point 2: 20000", mesh=(np.diag([0, 0, 20000.0]), [[0, 1, 2]]))
        self.refused("mesh: face 0: names one vertex twice", mesh=(np.eye(3), [[0, 1, 1]]))
        self.refused("mesh: faces are numbers of vertices", mesh=(np.eye(3), [[0, 1, 1.5]]))
        self.refused("mesh: wanted a pair", mesh=self.film.inspiration.vertices)
        self.refused("mesh: a face names", mesh=(np.zeros((3, 3)), np.array([[0, 1, 3]])))
        self.refused("time_total_s", time_total_s=0)
        self.refused("time_total_s: wanted numbers, not <U1", time_total_s="1")
        self.refused("time_cpu_s", time_cpu_s=1)

    def test_names_that_evaluate_refuses_are_refused(self):
        for name in ("", " ", "two\nlines", "x" * 61, "Ours", "static CT", "ours_gn", "0urs", "\u043eurs"):
            self.refused("method: ", method=name)
            write_prediction(self.folder, self.film, np.zeros((9, 48, 48, 3), np.uint8), method="free")
            with open(os.path.join(self.folder, "prediction.json"), "w") as file:
                json.dump({"method": name}, file)
            with self.assertRaises(ProgramFailed):
                evaluate(os.path.join(films(), "truth"), self.folder)
            shutil.rmtree(self.folder)
        self.refused("method: wanted a name, not 3", method=3)

    @needs(torch, "torch cannot be imported here, so that no tensor is written")
    def test_tensors(self):
        image = torch.rand(9, 48, 48, 3)
        write_prediction(self.folder, self.film, image, phase=torch.linspace(0, 1, 9))
        shutil.rmtree(self.folder)
        word = "color, frame 0: is no array: Can't call numpy.. on Tensor that requires grad"
        self.refused(word, image.requires_grad_())

    def test_nothing_is_overwritten(self):
        os.mkdir(self.folder)
        open(os.path.join(self.folder, "notes.txt"), "w").close()
        with self.assertRaisesRegex(Error, "is not empty"):
            write_prediction(self.folder, self.film, np.zeros((9, 48, 48, 3), np.uint8))


if __name__ == "__main__":
    unittest.main()
