"""`rasterize` through torch."""

import importlib.util
import os
import unittest

import numpy as np

from respire_bench import Error, rasterize
from support import needs, scene, torch

NAMES = ("means", "quats", "scales", "opacities", "colors")


def tensors(arguments, names=NAMES):
    out = {k: torch.from_numpy(v.copy()) if isinstance(v, np.ndarray) else v for k, v in arguments.items()}
    for name in names:
        out[name].requires_grad_()
    return out


@needs(torch, "torch cannot be imported here, so that nothing of rasterize through torch is tested")
class ThroughTorch(unittest.TestCase):
    def test_gradcheck(self):
        for extra in (
            {},
            {"sh_degree": 2},
            {"render_mode": "RGB+D"},
            {"render_mode": "RGB+ED", "rasterize_mode": "antialiased"},
        ):
            leaves = tensors(scene(8, 5, width=20, height=18, coefficients=9 if "sh_degree" in extra else None) | extra)
            rest = {k: v for k, v in leaves.items() if k not in NAMES}

            def images(*of):
                return rasterize(**dict(zip(NAMES, of)), **rest)[:2]

            self.assertTrue(torch.autograd.gradcheck(images, [leaves[name] for name in NAMES], atol=1e-5))

    def test_gradcheck_of_channels_background_and_lens(self):
        names = (*NAMES, "features", "backgrounds", "Ks")
        features = np.random.default_rng(1).standard_normal((6, 2))
        background = np.array([[0.3, -0.2, 0.5, 0.7]])
        arguments = scene(6, 5, width=18, height=17, channels=4) | {"features": features, "backgrounds": background}
        leaves = tensors(arguments, names)
        lens = torch.stack([leaves["Ks"].detach()[0, i, j] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2))])
        lens.requires_grad_()
        rest = {k: v for k, v in leaves.items() if k not in names}

        def images(lens, *of):
            one, zero = torch.ones(()).double(), torch.zeros(()).double()
            K = torch.stack([lens[0], zero, lens[2], zero, lens[1], lens[3], zero, zero, one]).view(1, 3, 3)
            return rasterize(**dict(zip(names[:-1], of)), Ks=K, **rest)[:2]

        self.assertTrue(torch.autograd.gradcheck(images, [lens, *(leaves[name] for name in names[:-1])], atol=1e-5))

    def test_gradcheck_of_the_pose(self):
        leaves = tensors(scene(8, 5, width=20, height=18, coefficients=4) | {"sh_degree": 1}, ())
        start = leaves.pop("viewmats")[0]

        def images(xi):
            zero = torch.zeros((), dtype=xi.dtype)
            w = torch.stack([zero, -xi[2], xi[1], xi[2], zero, -xi[0], -xi[1], xi[0], zero]).view(3, 3)
            motion = torch.eye(4, dtype=xi.dtype)
            motion[:3, :3] = torch.matrix_exp(w)
            motion[:3, 3] = xi[3:]
            return rasterize(**leaves, viewmats=(motion @ start)[None])[:2]

        self.assertTrue(torch.autograd.gradcheck(images, [torch.zeros(6).double().requires_grad_()], atol=1e-5))

    def test_torch_and_numpy_are_the_same_to_the_bit(self):
        for dtype in (np.float32, np.float64):
            arguments = scene(100, dtype=dtype)
            image, alpha, meta = rasterize(**arguments)
            leaves = tensors(arguments)
            seen, seen_alpha, seen_meta = rasterize(**leaves)
            np.testing.assert_array_equal(seen.detach().numpy(), image)
            np.testing.assert_array_equal(seen_alpha.detach().numpy(), alpha)
            np.testing.assert_array_equal(seen_meta["visible"].numpy(), meta["visible"])
            by = np.random.default_rng(0).standard_normal(image.shape).astype(dtype)
            seen.backward(torch.from_numpy(by))
            found = meta["backward"](by)
            for name in NAMES:
                np.testing.assert_array_equal(leaves[name].grad.numpy(), found[name])

    def test_tensors_are_read_where_they_lie(self):
        import respire_bench.splat as module

        leaves = tensors(scene(dtype=np.float32))
        seen, forward = [], module.forward
        module.forward = lambda arrays, plan: seen.append(arrays) or forward(arrays, plan)
        try:
            rasterize(**leaves)
        finally:
            module.forward = forward
        for name in NAMES:
            self.assertEqual(seen[0][name].ctypes.data, leaves[name].data_ptr(), name)

    def test_views_that_are_not_contiguous(self):
        arguments = scene()
        leaves = tensors(arguments, ())
        plain, _, _ = rasterize(**leaves)
        wide = torch.zeros(30, 6).double()
        wide[:, ::2] = leaves["means"]
        means = wide[:, ::2].requires_grad_()
        image, _, _ = rasterize(**leaves | {"means": means})
        self.assertTrue(torch.equal(image, plain))
        image.sum().backward()
        self.assertEqual(means.grad.shape, (30, 3))

    def test_a_tensor_changed_in_place_is_noticed(self):
        leaves = tensors(scene())
        image, _, _ = rasterize(**leaves)
        with torch.no_grad():
            leaves["means"] += 1
        with self.assertRaisesRegex(RuntimeError, "modified by an inplace operation"):
            image.sum().backward()

    def test_two_passes_before_their_backward_passes(self):
        a, b = tensors(scene(seed=1)), tensors(scene(seed=2, width=70, height=30))
        (rasterize(**a)[0].square().sum() + rasterize(**b)[0].square().sum()).backward()
        for seed, leaves, size in ((1, a, {}), (2, b, {"width": 70, "height": 30})):
            alone = tensors(scene(seed=seed, **size))
            rasterize(**alone)[0].square().sum().backward()
            for name in NAMES:
                self.assertTrue(torch.equal(alone[name].grad, leaves[name].grad), name)

    def test_only_what_is_asked_for_gets_a_gradient(self):
        leaves = tensors(scene(), ("colors",))
        image, alpha, _ = rasterize(**leaves)
        (image.sum() + alpha.sum()).backward()
        self.assertIsNotNone(leaves["colors"].grad)
        self.assertIsNone(leaves["means"].grad)
        with torch.no_grad():
            self.assertFalse(rasterize(**leaves)[0].requires_grad)

    def test_alpha_alone(self):
        leaves = tensors(scene())
        rasterize(**leaves)[1].sum().backward()
        _, _, meta = rasterize(**scene())
        found = meta["backward"](None, np.ones((1, 32, 40, 1)))
        np.testing.assert_array_equal(leaves["opacities"].grad.numpy(), found["opacities"])

    def test_no_gaussian(self):
        for coefficients in (None, 4):
            arguments = scene(0, coefficients=coefficients) | {"sh_degree": coefficients and 1}
            for mode in ("RGB", "D", "ED", "RGB+D", "RGB+ED"):
                leaves = tensors(arguments | {"render_mode": mode, "backgrounds": np.array([[0.1, 0.2, 0.3]])})
                image, alpha, _ = rasterize(**leaves)
                (image.sum() + alpha.sum()).backward()
                for name in NAMES[:4] if mode in ("D", "ED") else NAMES:
                    self.assertEqual(leaves[name].grad.shape, leaves[name].shape, f"{name} {mode}")

    def test_no_gaussian_before_the_far_plane(self):
        leaves = tensors(scene())
        rasterize(**leaves, far_plane=1.0)[0].sum().backward()
        for name in NAMES:
            self.assertEqual(leaves[name].grad.abs().sum(), 0, name)

    def test_a_class_of_somebody_elses(self):
        class Mine(torch.Tensor):
            pass

        leaves = tensors(scene())
        means = leaves["means"].detach().as_subclass(Mine).requires_grad_()
        rasterize(**leaves | {"means": means})[0].sum().backward()
        self.assertEqual(means.grad.shape, (30, 3))

    def test_tensors_that_numpy_cannot_read_are_named(self):
        leaves = tensors(scene())
        with self.assertRaisesRegex(Error, "^colors: is sparse"):
            rasterize(**leaves | {"colors": leaves["colors"].detach().to_sparse()})
        held = scene()
        with self.assertRaisesRegex(Error, "^scales: is no array of numpy: .*grad"):
            rasterize(**held | {"scales": torch.from_numpy(held["scales"]).requires_grad_()})
        image, _, _ = rasterize(**leaves)
        by = torch.ones_like(image)
        by[0, 3, 7, 1] = torch.nan
        with self.assertRaisesRegex(Error, r"^the gradient of render_colors: channel 1 of pixel \(7, 3\) of camera 0"):
            image.backward(by)

    def test_wrong_tensors_are_named(self):
        leaves = tensors(scene(), ())
        for name, wrong in (("scales", leaves["scales"].float()), ("quats", leaves["quats"].numpy())):
            with self.assertRaisesRegex(Error, f"^{name}"):
                rasterize(**leaves | {name: wrong})
        with self.assertRaisesRegex(Error, "^means: torch.float16"):
            rasterize(**leaves | {"means": leaves["means"].half()})


@needs(torch, "torch cannot be imported here, so that rasterize is not compared with formulas in torch")
class AgainstFormulas(unittest.TestCase):
    """The independent torch code of the benchmark, which is gsplat's formulas."""

    def test_images_and_gradients(self):
        import reference

        for degree, background, centre in (
            (None, None, (35, 25)),
            (3, [0.2, 0.4, -0.1], (35, 25)),
            # Tiles of a larger picture.
            (None, None, (21, 33)),
            (1, None, (-20, 65)),
        ):
            arguments = scene(300, 7, coefficients=None if degree is None else 16, width=70, height=50)
            arguments["Ks"][0, :2, 2] = centre
            ours, theirs = tensors(arguments, (*NAMES, "Ks")), tensors(arguments, (*NAMES, "Ks"))
            behind = None if background is None else torch.tensor(background).double()
            image, alpha, _ = rasterize(
                **ours, sh_degree=degree, backgrounds=None if behind is None else behind[None]
            )
            theirs = {name: theirs[name] for name in (*NAMES, "viewmats", "Ks")}
            theirs_K = theirs.pop("Ks").detach()[0].requires_grad_()
            theirs["viewmat"], theirs["K"] = theirs.pop("viewmats")[0], theirs_K
            wanted, wanted_alpha = reference.rasterize(
                **theirs, width=70, height=50, sh_degree=degree, background=behind
            )
            self.assertLess((image[0] - wanted).abs().max().item(), 1e-9)
            self.assertLess((alpha[0] - wanted_alpha).abs().max().item(), 1e-9)
            by = torch.from_numpy(np.random.default_rng(1).standard_normal(wanted.shape))
            image.backward(by[None])
            wanted.backward(by)
            by_lens = [(0, 0), (1, 1), (0, 2), (1, 2)]
            found = {name: (ours[name].grad, theirs[name].grad) for name in NAMES}
            found["Ks"] = [torch.stack([grad[at] for at in by_lens]) for grad in (ours["Ks"].grad[0], theirs_K.grad)]
            for name, (mine, formulas) in found.items():
                self.assertLess(((mine - formulas).norm() / formulas.norm()).item(), 1e-9, f"{name}, {centre}")

    def test_the_formulas_are_gsplats(self):
        import reference

        spec = importlib.util.find_spec("gsplat")
        path = spec and os.path.join(spec.submodule_search_locations[0], "cuda", "_torch_impl.py")
        if not path or not os.path.exists(path):
            self.skipTest("gsplat is not installed: its own formulas are not compared with those of the benchmark")
        spec = importlib.util.spec_from_file_location("gsplat_torch_impl", path)
        gsplat = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(gsplat)
        of = tensors(scene(300, 7, coefficients=16, width=70, height=50), ())
        covars, _ = gsplat._quat_scale_to_covar_preci(of["quats"], of["scales"], True, False)
        _, means2d, depths, conics, _ = gsplat._fully_fused_projection(
            of["means"], covars, of["viewmats"], of["Ks"], 70, 50
        )
        found = reference.project(
            of["means"], of["quats"], of["scales"], of["viewmats"][0], of["Ks"][0], 70, 50, 0.3
        )
        for ours, theirs in zip(found, (means2d, conics, depths)):
            self.assertLess((ours - theirs[0]).abs().max().item(), 1e-9)
        directions = torch.nn.functional.normalize(of["means"], dim=-1)
        for degree in range(4):
            theirs = gsplat._spherical_harmonics(degree, of["means"], of["colors"])
            self.assertLess((reference.harmonics(degree, directions, of["colors"]) - theirs).abs().max().item(), 1e-9)


if __name__ == "__main__":
    unittest.main()
