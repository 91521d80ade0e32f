"""`rasterize`: gsplat's `rasterization` (1.5.3) on CPU, by the splat core of respire-bench."""

import math

import numpy as np

from ._native import Error, forward

MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")
"""What the channels of the image may be: colours, accumulated or expected z-depth."""


class Meta(dict):
    """What a call tells beside its images. Keys of gsplat that the core has not raise a `KeyError` that says so."""

    def __missing__(self, key):
        raise KeyError(f"{key}: this core does not compute it; there are {', '.join(self)}")


def _refuse_unless(holds, sentence):
    if not holds:
        raise Error(sentence)


def _shape(name, array, *wanted):
    """Compares a shape with the wanted one, in which `None` is any length."""
    found = tuple(array.shape)
    fits = len(found) == len(wanted) and all(w is None or f == w for f, w in zip(found, wanted))
    shown = ", ".join("?" if w is None else str(w) for w in wanted)
    _refuse_unless(fits, f"{name}: has shape {found} instead of ({shown})")
    return found


class _Call:
    """The arguments of a call that are no arrays, checked; and the plan of each camera."""

    def __init__(self, arrays, viewmats, Ks, backgrounds, width, height, sh_degree, mode, fisheye, plan):
        means, colors, features = arrays["means"], arrays["colors"], arrays["features"]
        _refuse_unless(mode in MODES, f"render_mode: {mode!r} is none of {', '.join(MODES)}")
        _refuse_unless(len(means.shape) == 2, f"means: has shape {tuple(means.shape)}; batches of scenes are not here")
        n, _ = _shape("means", means, None, 3)
        _shape("quats", arrays["quats"], n, 4)
        _shape("scales", arrays["scales"], n, 3)
        _shape("opacities", arrays["opacities"], n)
        self.cameras = _shape("viewmats", viewmats, None, 4, 4)[0]
        _shape("Ks", Ks, self.cameras, 3, 3)
        _refuse_unless(self.cameras > 0, "viewmats: holds no camera")
        self.color = mode.startswith("RGB")
        self.sh_degree = sh_degree
        self.widths = [0, 0, int(mode != "RGB")]
        plain = 2 if sh_degree is None else 3
        self.per_camera = len(colors.shape) == plain + 1
        views = (self.cameras,) if self.per_camera else ()
        if sh_degree is None:
            self.widths[0] = _shape("colors", colors, *views, n, None)[-1] if self.color else 0
        else:
            _refuse_unless(sh_degree in (0, 1, 2, 3), f"sh_degree: {sh_degree} is not 0, 1, 2 or 3")
            held = _shape("colors", colors, *views, n, None, 3)[-2]
            wanted = (sh_degree + 1) ** 2
            _refuse_unless(held >= wanted, f"colors: {held} coefficients, degree {sh_degree} has {wanted}")
            self.widths[0] = 3 if self.color else 0
        if features is not None:
            self.widths[1] = _shape("features", features, n, None)[-1]
        if backgrounds is not None:
            _shape("backgrounds", backgrounds, self.cameras, self.widths[0])
        if fisheye is not None:
            _shape("radial_coeffs", fisheye, self.cameras, 4)
        self.size = (height, width)
        self.mode, self.fisheye, self.plan = mode, fisheye, plan

    def of_camera(self, camera, viewmat, K, background):
        """The plan of one camera, from arrays of numpy."""
        K = np.asarray(K, dtype=np.float64)
        skew = [K[0, 1], K[1, 0], K[2, 0], K[2, 1]]
        _refuse_unless(not any(skew) and K[2, 2] == 1, "Ks: has a skew, or its last row is not 0 0 1")
        plan = dict(self.plan, sh_degree=self.sh_degree, color=self.color, depth={"D": 1, "ED": 2}.get(
            self.mode.removeprefix("RGB+"), 0))
        plan["width"], plan["height"] = self.size[1], self.size[0]
        plan["fisheye"] = None if self.fisheye is None else [float(k) for k in self.fisheye[camera]]
        plan["viewmat"] = np.asarray(viewmat, dtype=np.float64).reshape(-1).tolist()
        plan["intrinsics"] = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        plan["background"] = [] if background is None else np.asarray(background, dtype=np.float64).tolist()
        return plan

    def colors_of(self, colors, camera):
        """The colours that one camera shows: of the bands that are used, a view."""
        colors = colors[camera] if self.per_camera else colors
        return colors if self.sh_degree is None else colors[:, : (self.sh_degree + 1) ** 2]

    def meta(self, visible, entries):
        return Meta(
            width=self.size[1],
            height=self.size[0],
            tile_size=16,
            n_cameras=self.cameras,
            visible=visible,
            tile_entries=entries,
        )


def _matrix_of_intrinsics(by):
    """The gradient of K from that of `fl_x, fl_y, cx, cy`."""
    return [[by[0], 0, by[2]], [0, by[1], by[3]], [0, 0, 0]]


def _contiguous(array):
    """The array as it is where it is contiguous, else a copy."""
    return np.ascontiguousarray(array)


class _NumpyPass:
    """All cameras of a call on arrays of numpy, and the backward pass."""

    def __init__(self, call, arrays, viewmats, Ks, backgrounds):
        self.call, self.arrays, self.passes = call, arrays, []
        self.dtype = arrays["means"].dtype
        images, alphas, visible, entries = [], [], [], 0
        height, width = call.size
        for c in range(call.cameras):
            plan = call.of_camera(c, viewmats[c], Ks[c], None if backgrounds is None else backgrounds[c])
            kept, image, alpha, shown, count = forward(self._of_camera(c), plan)
            self.passes.append(kept)
            images.append(image.reshape(height, width, sum(call.widths)))
            alphas.append(alpha.reshape(height, width, 1))
            visible.append(shown)
            entries += count
        one = call.cameras == 1
        self.image = images[0][None] if one else np.stack(images)
        self.alpha = alphas[0][None] if one else np.stack(alphas)
        self.meta = call.meta(np.stack(visible), entries)
        self.meta["backward"] = self.backward

    def _of_camera(self, camera):
        return dict(self.arrays, colors=_contiguous(self.call.colors_of(self.arrays["colors"], camera)))

    def backward(self, by_colors=None, by_alphas=None):
        """Gradients by the names of the arguments, from those of the images (as returned; `None` is 0)."""
        call = self.call
        shape = (call.cameras, *call.size, sum(call.widths))
        by_colors = np.zeros(shape, self.dtype) if by_colors is None else np.asarray(by_colors, self.dtype)
        _shape("by_colors", by_colors, *shape)
        if by_alphas is not None:
            by_alphas = np.asarray(by_alphas, self.dtype)
            _shape("by_alphas", by_alphas, *shape[:3], 1)
        names = ("means", "quats", "scales", "opacities", "colors", "features")
        wanted = {name: self.arrays[name] is not None for name in names} | {"viewmats": True, "Ks": True}
        found = {name: np.zeros_like(self.arrays[name]) for name in names if wanted[name]}
        found |= {"viewmats": [], "Ks": [], "backgrounds": []}
        for c, kept in enumerate(self.passes):
            by_alpha = None if by_alphas is None else _contiguous(by_alphas[c])
            by = kept.backward(self._of_camera(c), _contiguous(by_colors[c]), by_alpha, wanted)
            for name in names:
                if name in by:
                    target = call.colors_of(found[name], c) if name == "colors" else found[name]
                    target += by[name].reshape(target.shape)
            found["viewmats"].append(by["viewmats"].reshape(4, 4))
            found["Ks"].append(np.array(_matrix_of_intrinsics(by["Ks"])))
            found["backgrounds"].append(by["backgrounds"])
        return {name: np.stack(by) if isinstance(by, list) else by for name, by in found.items()}


def _rasterize_numpy(call, arrays, viewmats, Ks, backgrounds):
    done = _NumpyPass(call, arrays, viewmats, Ks, backgrounds)
    return done.image, done.alpha, done.meta


def rasterize(
    means,
    quats,
    scales,
    opacities,
    colors,
    viewmats,
    Ks,
    width,
    height,
    near_plane=0.01,
    far_plane=1e10,
    radius_clip=0.0,
    eps2d=0.3,
    sh_degree=None,
    packed=True,
    tile_size=16,
    backgrounds=None,
    render_mode="RGB",
    sparse_grad=False,
    absgrad=False,
    rasterize_mode="classic",
    channel_chunk=32,
    distributed=False,
    camera_model="pinhole",
    segmented=False,
    covars=None,
    with_ut=False,
    with_eval3d=False,
    radial_coeffs=None,
    tangential_coeffs=None,
    thin_prism_coeffs=None,
    ftheta_coeffs=None,
    rolling_shutter=None,
    viewmats_rs=None,
    *,
    features=None,
):
    """Renders Gaussians in the views of some cameras, differentiably: gsplat's `rasterization`, on CPU.

    Arrays are torch tensors on the CPU, or arrays of numpy; float32, or float64 for the plain core that serves as an
    oracle. Names, shapes and conventions are gsplat's:

    means        (N, 3)
    quats        (N, 4), `w x y z`, of any length but 0
    scales       (N, 3), standard deviations
    opacities    (N,), in 0..1
    colors       (N, D) or (C, N, D), any D; with `sh_degree` SH coefficients, (N, K, 3) or (C, N, K, 3)
    viewmats     (C, 4, 4), world to camera, rigid
    Ks           (C, 3, 3), pixels
    sh_degree    0 to 3, at most what K holds
    backgrounds  (C, D)
    render_mode  `RGB`, `D` (accumulated z-depth), `ED` (expected), `RGB+D`, `RGB+ED`
    rasterize_mode   `classic`, or `antialiased` (Mip-Splatting)
    camera_model     `pinhole`, or `fisheye` (OpenCV's, with `k1..k4` in `radial_coeffs` (C, 4); 0 without)
    features     not gsplat's: (N, E), further channels of every Gaussian after the colours

    Returns `(render_colors, render_alphas, meta)`: (C, height, width, D + E + depth), (C, height, width, 1), and a
    `Meta`: `visible` (C, N), `tile_entries`. Gradients go to all arrays, also to `viewmats` (that part of the gradient
    which is tangent to the rigid motions), `Ks` and `backgrounds`. With numpy, `meta["backward"](by_colors, by_alphas)`
    returns them as a dict.

    `packed`, `channel_chunk` and `segmented` change nothing here, as in gsplat's image. What the core cannot do is
    refused by an `Error` that names the argument, and so are numbers that are not finite in a gradient of the image.
    Differences from gsplat, with their size: docs/python.md.
    """
    for name, value, usual in (
        ("radius_clip", radius_clip, 0.0),
        ("tile_size", tile_size, 16),
        ("sparse_grad", sparse_grad, False),
        ("absgrad", absgrad, False),
        ("distributed", distributed, False),
        ("covars", covars, None),
        ("with_ut", with_ut, False),
        ("with_eval3d", with_eval3d, False),
        ("tangential_coeffs", tangential_coeffs, None),
        ("thin_prism_coeffs", thin_prism_coeffs, None),
        ("ftheta_coeffs", ftheta_coeffs, None),
        ("viewmats_rs", viewmats_rs, None),
    ):
        _refuse_unless(
            value is usual or (usual is not None and value == usual), f"{name}: only {usual} is here, this core has no other"
        )
    shutter = getattr(rolling_shutter, "name", rolling_shutter)
    _refuse_unless(shutter in (None, "GLOBAL"), "rolling_shutter: only a global shutter is here")
    _refuse_unless(rasterize_mode in ("classic", "antialiased"), f"rasterize_mode: {rasterize_mode!r} is neither classic nor antialiased")
    _refuse_unless(camera_model in ("pinhole", "fisheye"), f"camera_model: {camera_model!r} is neither pinhole nor fisheye")
    is_fisheye = camera_model == "fisheye"
    _refuse_unless(is_fisheye or radial_coeffs is None, "radial_coeffs: only a fisheye has them here")
    for name, value in (("width", width), ("height", height)):
        _refuse_unless(value == int(value) and 0 < value <= 16384, f"{name}: {value} is not within 1 to 16384")
    for name, value, least in (("near_plane", near_plane, 0), ("far_plane", far_plane, near_plane), ("eps2d", eps2d, -1e-300)):
        _refuse_unless(math.isfinite(value) and value > least, f"{name}: {value} is out of range")
    plan = {
        "near_plane": float(near_plane),
        "far_plane": float(far_plane),
        "eps2d": float(eps2d),
        "antialiased": rasterize_mode == "antialiased",
    }
    arrays = {
        "means": means,
        "quats": quats,
        "scales": scales,
        "opacities": opacities,
        "colors": colors,
        "features": features,
    }
    if type(means).__module__.partition(".")[0] == "torch":
        from ._torch import prepared, render
    else:
        prepared, render = _prepared_numpy, _rasterize_numpy
    arrays, viewmats, Ks, backgrounds, radial_coeffs = prepared(arrays, viewmats, Ks, backgrounds, radial_coeffs)
    if is_fisheye and radial_coeffs is None:
        radial_coeffs = np.zeros((viewmats.shape[0], 4))
    call = _Call(
        arrays, viewmats, Ks, backgrounds, int(width), int(height), sh_degree, render_mode, radial_coeffs, plan
    )
    return render(call, arrays, viewmats, Ks, backgrounds)


def _prepared_numpy(arrays, viewmats, Ks, backgrounds, radial_coeffs):
    dtype = np.asarray(arrays["means"]).dtype
    _refuse_unless(dtype in (np.float32, np.float64), f"means: {dtype} is neither float32 nor float64")

    def checked(name, array):
        if array is None:
            return None
        array = np.asarray(array)
        _refuse_unless(array.dtype == dtype, f"{name}: is {array.dtype}, means are {dtype}")
        return array if name == "colors" else _contiguous(array)

    arrays = {name: checked(name, array) for name, array in arrays.items()}
    return arrays, np.asarray(viewmats), np.asarray(Ks), *(
        None if array is None else np.asarray(array) for array in (backgrounds, radial_coeffs)
    )
