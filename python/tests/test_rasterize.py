"""`rasterize` on arrays of numpy."""

import copy
import itertools
import pickle
import threading
import unittest

import numpy as np

import respire_bench
from respire_bench import Error, rasterize
from support import forked, scene

NAMES = ("means", "quats", "scales", "opacities", "colors")


def random_like(array, seed=9):
    return np.random.default_rng(seed).uniform(-1, 1, array.shape).astype(array.dtype)


def loss_and_gradients(arguments):
    """A random weighting of the images, and its gradients by all arrays."""
    image, alpha, meta = rasterize(**arguments)
    by_image, by_alpha = random_like(image), random_like(alpha, 10)
    return (image * by_image).sum() + (alpha * by_alpha).sum(), meta["backward"](by_image, by_alpha)


def loss_of(arguments):
    image, alpha, _ = rasterize(**arguments)
    return (image * random_like(image)).sum() + (alpha * random_like(alpha, 10)).sum()


class Gradients(unittest.TestCase):
    """Against central differences of the forward pass of the double-precision core."""

    def differences_agree(self, arguments, names=NAMES, values=12):
        _, gradients = loss_and_gradients(arguments)
        r = np.random.default_rng(4)
        for name in names:
            found, array = gradients[name], arguments[name]
            self.assertEqual(found.shape, array.shape)
            self.assertGreater(np.abs(found).max(), 0, name)
            size = np.sqrt(np.mean(found**2))
            for k in r.choice(array.size, min(values, array.size), replace=False):
                if name == "Ks" and k not in (0, 2, 4, 5):
                    continue
                best = np.inf
                # A decision may change between the two ends of a step (a pixel crosses alpha 1/255): no step hides a
                # wrong gradient.
                for step in (1e-6, 1e-7, 3e-8):
                    ends = []
                    for sign in (1, -1):
                        moved = array.copy()
                        moved.reshape(-1)[k] += sign * step
                        ends.append(loss_of(arguments | {name: moved}))
                    wanted = (ends[0] - ends[1]) / (2 * step)
                    best = min(best, abs(found.reshape(-1)[k] - wanted) / max(abs(wanted), 0.1 * size))
                self.assertLess(best, 2e-5, f"{name}, value {k}")

    def test_plain_colors(self):
        self.differences_agree(scene())

    def test_spherical_harmonics_of_fewer_bands_than_are_held(self):
        self.differences_agree(scene(coefficients=16) | {"sh_degree": 2})

    def test_any_number_of_colors_with_background(self):
        for channels in (1, 2, 4, 7):
            background = np.linspace(-0.5, 1, channels)[None]
            self.differences_agree(scene(channels=channels) | {"backgrounds": background}, (*NAMES, "backgrounds"), 6)

    def test_features_and_depths(self):
        features = np.random.default_rng(3).standard_normal((30, 2))
        for mode in ("RGB+D", "RGB+ED"):
            arguments = scene(coefficients=4) | {"sh_degree": 1, "features": features, "render_mode": mode}
            self.differences_agree(arguments, (*NAMES, "features"), 6)

    def test_depth_alone(self):
        for mode in ("D", "ED"):
            self.differences_agree(scene() | {"render_mode": mode}, NAMES[:4], 6)

    def test_colors_far_below_zero(self):
        # Too far to be lifted: all of them are further channels of the core.
        for channels in (1, 3, 5):
            arguments = scene(channels=channels) | {"features": random_like(np.zeros((30, 2)))}
            arguments["colors"][:, 0] -= 5
            arguments["backgrounds"] = np.linspace(-3, 1, channels)[None]
            self.differences_agree(arguments, (*NAMES, "features", "backgrounds"), 6)

    def test_antialiased(self):
        self.differences_agree(scene() | {"rasterize_mode": "antialiased", "eps2d": 0.5})

    def test_fisheye(self):
        lens = np.array([[0.02, -0.004, 0.001, 0.0]])
        self.differences_agree(scene() | {"camera_model": "fisheye", "radial_coeffs": lens}, (*NAMES, "Ks"))

    def test_intrinsics(self):
        self.differences_agree(scene(), ("Ks",))

    def test_pose(self):
        arguments = scene(coefficients=9) | {"sh_degree": 2}
        _, gradients = loss_and_gradients(arguments)
        viewmat = arguments["viewmats"][0]

        def moved(xi):
            # exp(xi) to second order is enough for a central difference.
            w = np.array([[0, -xi[2], xi[1]], [xi[2], 0, -xi[0]], [-xi[1], xi[0], 0]])
            motion = np.eye(4)
            motion[:3, :3] += w + w @ w / 2
            motion[:3, 3] = xi[3:]
            return motion @ viewmat

        for axis in range(6):
            step = np.zeros(6)
            step[axis] = 1e-6
            ends = [loss_of(arguments | {"viewmats": moved(sign * step)[None]}) for sign in (1, -1)]
            tangent = (moved(step) - moved(-step)) / 2e-6
            wanted, found = (ends[0] - ends[1]) / 2e-6, (gradients["viewmats"][0] * tangent).sum()
            self.assertLess(abs(found - wanted), 1e-4 * max(1, abs(wanted)), f"axis {axis}")

    def test_a_wrong_gradient_fails(self):
        backward = respire_bench.splat._Pass.backward

        def wrong(done, *by):
            found = backward(done, *by)
            found["quats"] *= 1.001
            return found

        respire_bench.splat._Pass.backward = wrong
        try:
            with self.assertRaises(AssertionError):
                self.differences_agree(scene(), ("quats",))
        finally:
            respire_bench.splat._Pass.backward = backward


class Images(unittest.TestCase):
    def test_single_precision_agrees_with_the_oracle(self):
        for extra in ({}, {"sh_degree": 3}, {"render_mode": "RGB+ED"}, {"rasterize_mode": "antialiased"}):
            coefficients = 16 if "sh_degree" in extra else None
            exact = scene(400, coefficients=coefficients, width=96, height=80) | extra
            rounded = {k: v.astype(np.float32) if isinstance(v, np.ndarray) else v for k, v in exact.items()}
            widened = {k: v.astype(np.float64) if isinstance(v, np.ndarray) else v for k, v in rounded.items()}
            (image, alpha, meta), (oracle, oracle_alpha, oracle_meta) = rasterize(**rounded), rasterize(**widened)
            self.assertEqual((image.dtype, oracle.dtype), (np.float32, np.float64))
            self.assertEqual(image.shape, (1, 80, 96, 3 + ("render_mode" in extra)))
            self.assertLess(np.abs(image - oracle).max(), 2e-4 * max(1, np.abs(oracle).max()))
            self.assertLess(np.abs(alpha - oracle_alpha).max(), 2e-4)
            by = random_like(oracle)
            found = meta["backward"](by.astype(np.float32))
            wanted = oracle_meta["backward"](by)
            for name in (*NAMES, "viewmats", "Ks"):
                error = np.sqrt(np.mean((found[name] - wanted[name]) ** 2) / np.mean(wanted[name] ** 2))
                self.assertLess(error, 1e-3, f"{name} {extra}")

    def test_one_gaussian_by_hand(self):
        # At the centre of the image, one pixel: sigma 2 mm at 10 mm, focal length 100 px, so 20 px, plus the filter.
        arguments = {
            "means": np.array([[0.0, 0, 10]]),
            "quats": np.array([[1.0, 0, 0, 0]]),
            "scales": np.full((1, 3), 2.0),
            "opacities": np.array([0.5]),
            "colors": np.array([[0.2, -0.4, 0.9]]),
            "viewmats": np.eye(4)[None],
            "Ks": np.array([[[100.0, 0, 16], [0, 100, 16], [0, 0, 1]]]),
            "width": 32,
            "height": 32,
        }
        image, alpha, meta = rasterize(**arguments, backgrounds=np.array([[0.1, 0.1, 0.1]]), render_mode="RGB+D")
        variance = (100 * 2 / 10) ** 2 + 0.3
        expected = 0.5 * np.exp(-0.5 * (10.5**2 + 3.5**2) / variance)
        self.assertAlmostEqual(alpha[0, 19, 26, 0], expected, 12)
        color = expected * np.array([0.2, -0.4, 0.9]) + (1 - expected) * 0.1
        np.testing.assert_allclose(image[0, 19, 26], [*color, 10 * expected], atol=1e-12)
        self.assertTrue(meta["visible"][0, 0])

    def test_cameras_are_rendered_one_by_one(self):
        arguments = scene()
        second = arguments["viewmats"].copy()
        second[0, 0, 3] += 0.4
        K = arguments["Ks"] * [[[1.2], [1.2], [1]]]
        colors = np.stack([arguments["colors"], arguments["colors"][::-1]])
        both = arguments | {
            "viewmats": np.concatenate([arguments["viewmats"], second]),
            "Ks": np.concatenate([arguments["Ks"], K]),
            "colors": colors,
        }
        image, alpha, meta = rasterize(**both)
        by = random_like(image)
        gradients = meta["backward"](by)
        for c in range(2):
            one = {name: both[name][c : c + 1] for name in ("viewmats", "Ks")} | {"colors": colors[c]}
            single, single_alpha, single_meta = rasterize(**arguments | one)
            np.testing.assert_array_equal(single[0], image[c])
            np.testing.assert_array_equal(single_alpha[0], alpha[c])
            found = single_meta["backward"](by[c : c + 1])
            np.testing.assert_allclose(gradients["viewmats"][c], found["viewmats"][0])
            np.testing.assert_allclose(gradients["colors"][c], found["colors"])
            gradients["means"] -= found["means"]
        self.assertLess(np.abs(gradients["means"]).max(), 1e-9)

    def test_the_far_plane_leaves_out_what_is_behind(self):
        arguments = scene()
        z = (arguments["viewmats"][0, :3, :3] @ arguments["means"].T).T[:, 2] + 0.2
        near = {name: arguments[name][z <= 4.5] for name in NAMES}
        image, _, meta = rasterize(**arguments, far_plane=4.5)
        wanted, _, near_meta = rasterize(**arguments | near)
        np.testing.assert_array_equal(image, wanted)
        by = random_like(image)
        np.testing.assert_array_equal(meta["backward"](by)["quats"][z <= 4.5], near_meta["backward"](by)["quats"])
        self.assertEqual(np.abs(meta["backward"](by)["colors"][z > 4.5]).max(), 0)
        self.assertFalse(meta["visible"][0, z > 4.5].any())

    def test_no_gaussian(self):
        kinds = ((None, 3, None), (None, 1, 2), (None, 5, 2), (9, 3, None), (9, 3, 2))
        for mode in ("RGB", "D", "ED", "RGB+D", "RGB+ED"):
            for coefficients, channels, features in kinds:
                arguments = scene(0, coefficients=coefficients, channels=channels)
                arguments |= {"render_mode": mode, "far_plane": 5.0}
                color = channels if "RGB" in mode else 0
                behind = np.linspace(0.2, 1, channels)
                arguments |= {"backgrounds": behind[None], "sh_degree": coefficients and 2}
                arguments["features"] = features and np.zeros((0, features))
                image, alpha, meta = rasterize(**arguments)
                wanted = np.zeros((1, 32, 40, color + (features or 0) + (mode != "RGB")))
                wanted[..., :color] = behind[:color]
                np.testing.assert_array_equal(image, wanted)
                np.testing.assert_array_equal(alpha, 0)
                self.assertEqual(meta["visible"].shape, (1, 0))
                gradients = meta["backward"](np.ones_like(image), np.ones_like(alpha))
                for name, gradient in gradients.items():
                    self.assertEqual(gradient.shape, arguments[name].shape, f"{name} {mode}")
                np.testing.assert_array_equal(gradients["backgrounds"], 32 * 40 if color else 0)

    def test_no_gaussian_before_the_far_plane(self):
        for extra in ({}, {"features": np.ones((30, 2))}, {"render_mode": "RGB+ED"}, {"sh_degree": 1}):
            arguments = scene(coefficients=4 if "sh_degree" in extra else None) | extra
            image, alpha, meta = rasterize(**arguments, far_plane=1.0)
            self.assertFalse(image.any() or alpha.any() or meta["visible"].any())
            for name, gradient in meta["backward"](np.ones_like(image), np.ones_like(alpha)).items():
                self.assertFalse(gradient.any(), name)
                if name != "backgrounds":
                    self.assertEqual(gradient.shape, arguments[name].shape)

    def test_a_negative_color_spoils_no_other(self):
        single, double = scene(dtype=np.float32), scene()
        for lowest in (-0.9, -1.1, -1e4, -1e7):
            seen = []
            for arguments in (single, double):
                colors = arguments["colors"].copy()
                colors[3, 0] = lowest
                image, _, meta = rasterize(**arguments | {"colors": colors})
                by = random_like(np.zeros(image.shape)).astype(image.dtype)
                by[..., 0] = 0
                seen.append((image[..., 1:], meta["backward"](by)))
            (image, found), (wanted, gradients) = seen
            self.assertLess(np.abs(image - wanted).max(), 1e-6, lowest)
            for name in NAMES:
                error = np.abs(found[name] - gradients[name]).max() / np.abs(gradients[name]).max()
                self.assertLess(error, 1e-4, f"{name} {lowest}")

    def test_what_is_not_finite_is_left_out(self):
        # But for plain colours and features, which are refused.
        for name, wrong, dtype in itertools.product(NAMES, (np.nan, np.inf), (np.float32, np.float64)):
            with self.subTest(name=name, wrong=wrong, dtype=dtype):
                arguments = scene(coefficients=4, dtype=dtype) | {"sh_degree": 1}
                rest = {k: np.delete(arguments[k], 4, 0) for k in NAMES}
                arguments[name].reshape(30, -1)[4, 0] = wrong
                image, _, meta = rasterize(**arguments)
                np.testing.assert_allclose(image, rasterize(**arguments | rest)[0], atol=1e-6)
                self.assertFalse(meta["visible"][0, 4])
                gradients = meta["backward"](np.ones_like(image))
                self.assertTrue(all(np.isfinite(gradient).all() for gradient in gradients.values()))
                self.assertFalse(any(gradients[k][4].any() for k in NAMES))

    def test_arrays_that_are_not_aligned(self):
        arguments = scene()
        plain, gradients = loss_and_gradients(arguments)
        for name in NAMES:
            held = arguments[name]
            memory = np.zeros(held.nbytes + 1, np.uint8)
            shifted = memory[1:].view(held.dtype).reshape(held.shape)
            shifted[...] = held
            self.assertFalse(shifted.flags.aligned)
            loss, found = loss_and_gradients(arguments | {name: shifted})
            self.assertEqual(loss, plain)
            np.testing.assert_array_equal(found[name], gradients[name])

    def test_quaternions_of_any_length(self):
        for dtype, lengths in ((np.float32, (1e-30, 1e-22, 1e20, 1e30)), (np.float64, (1e-200, 1e-30, 1e30, 1e200))):
            arguments = scene(dtype=dtype)
            quats = arguments["quats"]
            image, _, meta = rasterize(**arguments)
            gradient = meta["backward"](random_like(image))["quats"]
            for length in lengths:
                scaled = (quats.astype(np.float64) * length).astype(dtype)
                found, _, meta = rasterize(**arguments | {"quats": scaled})
                np.testing.assert_allclose(found, image, atol=1e-5)
                by = meta["backward"](random_like(image))["quats"].astype(np.float64) * length
                np.testing.assert_allclose(by, gradient, rtol=1e-2, atol=1e-3 * np.abs(gradient).max())

    def test_planes_at_the_ends(self):
        plain, _, _ = rasterize(**scene())
        np.testing.assert_array_equal(rasterize(**scene(), near_plane=0, far_plane=np.inf)[0], plain)
        close = scene(1, dtype=np.float32)
        close["means"][:], close["scales"][:], close["viewmats"][0] = [0, 0, 1e-4], 1e-5, np.eye(4)
        self.assertEqual(rasterize(**close)[1].max(), 0)
        self.assertGreater(rasterize(**close, near_plane=0)[1].max(), 0.1)

    def test_nothing_is_behind_a_depth(self):
        for mode in ("D", "ED"):
            plain, _, _ = rasterize(**scene(), render_mode=mode)
            for width in (1, 3):
                behind = np.full((1, width), np.nan)
                image, _, meta = rasterize(**scene(), render_mode=mode, backgrounds=behind)
                np.testing.assert_array_equal(image, plain)
                np.testing.assert_array_equal(meta["backward"](image)["backgrounds"], np.zeros((1, width)))

    def test_a_forked_child_renders(self):
        arguments = scene(3000, dtype=np.float32)
        image, _, meta = rasterize(**arguments)

        def both():
            image, _, meta = rasterize(**arguments)
            return image, meta["backward"](np.ones_like(image))["means"]

        def in_a_thread(compute):
            found = []
            thread = threading.Thread(target=lambda: found.append(compute()))
            thread.start()
            thread.join()
            return found[0]

        wanted = meta["backward"](np.ones_like(image))["means"]
        in_a_thread(both)
        # From the thread that forked, from another one, and from a fork of the fork; the same with a fork by a thread
        # that is in no pool of the parent.
        ways = (both, lambda: in_a_thread(both), lambda: (both(), forked(both, 30))[1])
        for start in (lambda way: forked(way), lambda way: in_a_thread(lambda: forked(way))):
            for way in ways:
                found = start(way)
                np.testing.assert_array_equal(found[0], image)
                np.testing.assert_array_equal(found[1], wanted)

    def test_small_plain_colors_keep_their_digits(self):
        for channels in (3, 6):
            exact = scene(300, channels=channels)
            exact["colors"] -= 0.5
            single = {k: a.astype(np.float32) if isinstance(a, np.ndarray) else a for k, a in exact.items()}
            exact = {k: a.astype(np.float64) if isinstance(a, np.ndarray) else a for k, a in single.items()}
            for size in (1e-7, 1e-3, 0.04, 1):
                wanted, _, meta = rasterize(**exact | {"colors": exact["colors"] * size})
                by = random_like(wanted)
                means = meta["backward"](by)["means"]
                found, _, meta = rasterize(**single | {"colors": single["colors"] * np.float32(size)})
                np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-5 * np.abs(wanted).max())
                found = meta["backward"](by.astype(np.float32))["means"]
                self.assertLess(np.abs(found - means).max(), 1e-2 * np.abs(means).max())

    def test_threads_take_turns_in_one_backward_pass(self):
        image, _, meta = rasterize(**scene(3000, dtype=np.float32))
        wanted = meta["backward"](np.ones_like(image))["means"]
        found = []
        threads = [
            threading.Thread(target=lambda: found.append(meta["backward"](np.ones_like(image))["means"]))
            for _ in range(4)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.assertEqual(len(found), 4)
        for means in found:
            np.testing.assert_array_equal(means, wanted)

    def test_other_threads_get_the_same_bits(self):
        arguments = scene(300, dtype=np.float32)
        first, _ = rasterize(**arguments)[:2]
        found = []
        threads = [threading.Thread(target=lambda: found.append(rasterize(**arguments)[0])) for _ in range(3)]
        for thread in threads:
            thread.start()
        again = rasterize(**arguments)[0]
        for thread in threads:
            thread.join()
        self.assertEqual(len(found), 3)
        for image in (again, *found):
            np.testing.assert_array_equal(image, first)

    def test_passes_do_not_disturb_each_other(self):
        first, second = scene(seed=1), scene(seed=2, width=70, height=50)
        image, _, meta = rasterize(**first)
        alone = meta["backward"](random_like(image))
        _, _, other = rasterize(**second)
        again = meta["backward"](random_like(image))
        np.testing.assert_array_equal(alone["means"], again["means"])
        del other


class Refusals(unittest.TestCase):
    def refused(self, word, **wrong):
        with self.assertRaises(Error) as caught:
            rasterize(**scene() | wrong)
        self.assertTrue(str(caught.exception).startswith(word), str(caught.exception))

    def test_what_the_core_has_not_is_named(self):
        for name, value in (
            ("radius_clip", 2.0),
            ("radius_clip", np.zeros(2)),
            ("tile_size", 8),
            ("sparse_grad", True),
            ("absgrad", True),
            ("distributed", True),
            ("covars", np.zeros((30, 3, 3))),
            ("with_ut", True),
            ("with_eval3d", True),
            ("tangential_coeffs", np.zeros((1, 2))),
            ("thin_prism_coeffs", np.zeros((1, 4))),
            ("ftheta_coeffs", object()),
            ("rolling_shutter", "ROLLING_TOP_TO_BOTTOM"),
            ("viewmats_rs", np.eye(4)[None]),
            ("camera_model", "ortho"),
            ("rasterize_mode", "sharp"),
            ("render_mode", "N"),
            ("radial_coeffs", np.zeros((1, 4))),
            ("sh_degree", 4),
            ("sh_degree", 1.0),
            ("sh_degree", "1"),
        ):
            self.refused(name, **{name: value})
        for name in ("near_plane", "far_plane", "eps2d", "width", "height"):
            for value in (None, "1", [1, 2], 1j):
                self.refused(f"{name}: {value!r} is no number", **{name: value})
        for value in (np.nan, np.inf, -np.inf, 0, 1e300):
            self.refused(f"height: {value} is not within 1 to 16384", height=value)
        self.refused("width: 37.5 is not a whole number", width=37.5)

    def test_what_makes_no_difference_is_taken(self):
        plain, _, _ = rasterize(**scene())
        image, _, _ = rasterize(**scene(), packed=False, channel_chunk=3, segmented=True)
        np.testing.assert_array_equal(image, plain)

    def test_wrong_arrays_are_named(self):
        for name in (*NAMES, "viewmats", "Ks"):
            self.refused(f"{name}: is None", **{name: None}, render_mode="D")
            self.refused(name, **{name: "text"})
            self.refused(name, **{name: [[1.0], [2.0, 3.0]]})
        self.refused("backgrounds", backgrounds=np.full((1, 3), 1j))
        self.refused("means", means=np.zeros((2, 30, 3)))
        self.refused("quats", quats=np.zeros((30, 3)))
        self.refused("colors", colors=np.zeros((29, 3)))
        self.refused("colors", colors=np.zeros((30, 3, 3)), sh_degree=1)
        self.refused("scales", scales=np.zeros((30, 3), np.float32))
        self.refused("viewmats", viewmats=2 * np.eye(4)[None])
        self.refused("viewmats", viewmats=np.full((1, 4, 4), np.nan))
        self.refused("Ks", Ks=np.zeros((1, 3, 3)))
        self.refused("Ks", Ks=np.array([[[30.0, 1, 16], [0, 30, 16], [0, 0, 1]]]))
        second = np.stack([np.eye(4), 2 * np.eye(4)])
        self.refused("viewmats[1]", viewmats=second, Ks=np.repeat(scene()["Ks"], 2, axis=0))
        self.refused("backgrounds", backgrounds=np.zeros((1, 4)))
        self.refused("width", width=0)
        self.refused("backgrounds: is not finite", backgrounds=np.array([[0, np.nan, 0]]))
        self.refused("near_plane", near_plane=-0.1)
        self.refused("near_plane", near_plane=np.inf)
        self.refused("far_plane", far_plane=np.nan)
        self.refused("far_plane", far_plane=0.001)
        self.refused("eps2d", eps2d=-0.1)
        for wrong in (np.nan, np.inf, 1e300):
            coefficients = np.array([[0.1, 0, wrong, 0]])
            self.refused("radial_coeffs[0]: k3", camera_model="fisheye", radial_coeffs=coefficients)
            self.refused("Ks[0]: cx", Ks=np.array([[[30.0, 0, wrong], [0, 30, 16], [0, 0, 1]]]))

    def test_what_is_not_finite_is_named(self):
        for channels in (3, 5):
            for wrong in (np.nan, np.inf, -np.inf):
                colors = scene(channels=channels)["colors"]
                colors[4, channels - 1] = wrong
                self.refused(f"colors: channel {channels - 1} of Gaussian 4 is not finite", colors=colors)
                self.refused("features: channel 1 of Gaussian 4", features=colors[:, channels - 2 :])

    def test_more_channels_than_fit_into_memory_are_refused(self):
        # 30 GB for the image alone; the interpreter ended by a signal.
        few = scene(n=1, dtype=np.float32) | {"width": 16384, "height": 16384}
        few["colors"] = np.zeros((1, 4000), np.float32)
        with self.assertRaisesRegex(Error, "images of 4000 channels with 16384x16384 pixels would take .* GB"):
            rasterize(**few)
        few["features"], few["colors"] = few["colors"], few["colors"][:, :3]
        with self.assertRaisesRegex(Error, "images of 4003 channels"):
            rasterize(**few)

    def test_a_gradient_that_is_not_finite_is_named(self):
        image, _, meta = rasterize(**scene())
        by = np.ones_like(image)
        by[0, 3, 7, 1] = np.nan
        with self.assertRaisesRegex(Error, r"^by_colors: channel 1 of pixel \(7, 3\) of camera 0 is not finite"):
            meta["backward"](by)
        # Of the second camera; and where the core takes the colours for a part of another image.
        two = scene(channels=5) | {"backgrounds": np.ones((2, 5)), "render_mode": "RGB+D"}
        two |= {name: np.repeat(two[name], 2, axis=0) for name in ("viewmats", "Ks")}
        image, alpha, meta = rasterize(**two)
        for name, channel in (("by_colors", 4), ("by_colors", 5), ("by_alphas", 0)):
            by = {"by_colors": np.ones_like(image), "by_alphas": np.ones_like(alpha)}
            by[name][1, 3, 7, channel] = np.inf
            with self.assertRaisesRegex(Error, rf"^{name}: channel {channel} of pixel \(7, 3\) of camera 1"):
                meta["backward"](**by)
        with self.assertRaisesRegex(Error, "^by_alphas: is no array"):
            meta["backward"](None, "text")

    def test_a_pickled_meta_leaves_its_pass_behind(self):
        image, _, meta = rasterize(**scene())
        for same in (copy.copy(meta), copy.deepcopy(meta)):
            self.assertEqual(same["backward"](image).keys(), meta["backward"](image).keys())
        back = pickle.loads(pickle.dumps(meta))
        np.testing.assert_array_equal(back["visible"], meta["visible"])
        with self.assertRaisesRegex(Error, "^backward: was pickled"):
            back["backward"](image)

    def test_keys_of_gsplat_are_not_made_up(self):
        _, _, meta = rasterize(**scene())
        with self.assertRaisesRegex(KeyError, "means2d: this core does not compute it"):
            meta["means2d"]
        self.assertIsNone(meta.get("means2d"))


if __name__ == "__main__":
    unittest.main()
