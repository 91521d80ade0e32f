"""`rasterize`: gsplat's `rasterization` (1.5.3) on CPU, by the splat core of respire-bench."""

import functools
import math
import numbers
import sys
import threading

import numpy as np

from ._native import Error, forward

MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")
"""What the channels of the image may be: colours, accumulated or expected z-depth."""


_LEAST_DEPTH = float(np.finfo(np.float32).tiny)


class Meta(dict):
    """What a call tells beside its images. `meta[key]` of a key that gsplat alone has raises a `KeyError`."""

    def __missing__(self, key):
        if key == "backward":
            raise KeyError("backward: only a call with arrays of numpy has it; with torch, autograd has the gradients")
        raise KeyError(f"{key}: this core does not compute it; there are {', '.join(self)}")


def _refuse_unless(holds, sentence, *of):
    """Raises `sentence`, which is put together with `of` only then."""
    if not holds:
        raise Error(sentence.format(*of))


def _number(name, value):
    """A number of any type as a float."""
    try:
        if hasattr(value, "__float__") or hasattr(value, "__index__"):
            return float(value)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        pass
    raise Error(f"{name}: {value!r} is no number that can be used")


def _array(name, value, dtype=None):
    """An array of numpy."""
    try:
        array = np.asarray(value, dtype)
    except (TypeError, ValueError, RuntimeError) as why:
        raise Error(f"{name}: is no array of numpy: {why}") from None
    _refuse_unless(array.dtype.kind in "fiub", "{}: {} is no type of numbers that can be used", name, array.dtype)
    return array


def _for_core(array):
    """The array as the core reads it, contiguous and aligned."""
    return np.ascontiguousarray(array) if array.flags.aligned else array.copy(order="C")


def _shape(name, array, *wanted):
    """Compares a shape with the wanted one, in which `None` is any length."""
    found = tuple(array.shape)
    fits = len(found) == len(wanted)
    for length, length_wanted in zip(found, wanted):
        fits = fits and (length_wanted is None or length == length_wanted)
    if not fits:
        shown = ", ".join("?" if w is None else str(w) for w in wanted) + ("," if len(wanted) == 1 else "")
        raise Error(f"{name}: has shape {found} instead of ({shown})")
    return found


def _backgrounds(backgrounds, cameras, shown):
    """Those of each camera, a list of `shown` values."""
    _shape("backgrounds", backgrounds, cameras, shown)
    values = backgrounds.tolist()
    _refuse_unless(all(math.isfinite(value) for of in values for value in of), "backgrounds: is not finite")
    return values


class _Call:
    """The arguments of a call, checked; and the plan of each camera, which holds all of them that are no arrays of the
    Gaussians."""

    def __init__(self, arrays, viewmats, Ks, backgrounds, width, height, sh_degree, mode, fisheye, plan):
        means, colors, features = arrays["means"], arrays["colors"], arrays["features"]
        _refuse_unless(mode in MODES, "render_mode: {!r} is none of {}", mode, ", ".join(MODES))
        _refuse_unless(
            len(means.shape) == 2, "means: has shape {}; batches of scenes are not here", tuple(means.shape)
        )
        n, _ = _shape("means", means, None, 3)
        _shape("quats", arrays["quats"], n, 4)
        _shape("scales", arrays["scales"], n, 3)
        _shape("opacities", arrays["opacities"], n)
        cameras = _shape("viewmats", viewmats, None, 4, 4)[0]
        _shape("Ks", Ks, cameras, 3, 3)
        _refuse_unless(cameras > 0, "viewmats: holds no camera")
        color, depth = mode.startswith("RGB"), mode != "RGB"
        self.sh_degree = sh_degree
        plain = 2 if sh_degree is None else 3
        self.per_camera = len(colors.shape) == plain + 1
        views = (cameras,) if self.per_camera else ()
        if sh_degree is None:
            shown = _shape("colors", colors, *views, n, None)[-1] if color else 0
        else:
            whole = isinstance(sh_degree, numbers.Integral) and 0 <= sh_degree <= 3
            _refuse_unless(whole, "sh_degree: {!r} is not 0, 1, 2 or 3", sh_degree)
            held = _shape("colors", colors, *views, n, None, 3)[-2]
            wanted = (sh_degree + 1) ** 2
            _refuse_unless(held >= wanted, "colors: {} coefficients, degree {} has {}", held, sh_degree, wanted)
            shown = 3 if color else 0
        further = 0 if features is None else _shape("features", features, n, None)[-1]
        # Nothing is behind a depth, as in gsplat.
        behind = _backgrounds(backgrounds, cameras, shown) if color and backgrounds is not None else [None] * cameras
        if fisheye is not None:
            _shape("radial_coeffs", fisheye, cameras, 4)
        self.shape = (cameras, height, width, shown + further + depth)
        plan = plan | {
            "width": width,
            "height": height,
            "sh_degree": sh_degree,
            "colors": shown,
            "features": further,
            "depth": {"D": 1, "ED": 2}.get(mode.removeprefix("RGB+"), 0),
        }
        lenses = [None] * cameras if fisheye is None else fisheye.tolist()
        self.plans = []
        for c, (viewmat, K, background, k) in enumerate(zip(viewmats.tolist(), Ks.tolist(), behind, lenses)):
            (fl_x, *skew_x, cx), (*skew_y, fl_y, cy), last = K
            _refuse_unless(
                not any(skew_x + skew_y) and last == [0, 0, 1], "Ks[{}]: has a skew, or its last row is not 0 0 1", c
            )
            camera = {"camera": c, "viewmat": viewmat, "intrinsics": [fl_x, fl_y, cx, cy]}
            self.plans.append(plan | camera | {"background": background, "fisheye": k})

    def colors_of(self, colors, camera):
        """The colours that one camera shows: of the bands that are used, a view."""
        colors = colors[camera] if self.per_camera else colors
        return colors if self.sh_degree is None else colors[:, : (self.sh_degree + 1) ** 2]

    def meta(self, visible, entries):
        cameras, height, width, _ = self.shape
        return Meta(
            width=width, height=height, tile_size=16, n_cameras=cameras, visible=visible, tile_entries=entries
        )


def _joined(parts, *shape):
    """What the cameras gave, as one array; of one camera the same memory."""
    return (parts[0] if len(parts) == 1 else np.stack(parts)).reshape(shape)


class _Pass:
    """All cameras of a call rendered from arrays of numpy, kept for the backward pass."""

    def __init__(self, call, arrays):
        cameras, height, width, channels = call.shape
        self.call, self.held = call, arrays
        # One backward pass at a time: another thread's waits.
        self.turn = threading.Lock()
        # As the core reads them, for each camera.
        flat = {name: a if a is None or name == "colors" else _for_core(a) for name, a in arrays.items()}
        shown = [call.colors_of(arrays["colors"], c) for c in range(cameras if call.per_camera else 1)]
        self.arrays = [flat | {"colors": _for_core(colors)} for colors in shown]
        self.passes, images, alphas, visible, entries = zip(
            *(forward(self._of_camera(c), plan) for c, plan in enumerate(call.plans))
        )
        self.image = _joined(images, cameras, height, width, channels)
        self.alpha = _joined(alphas, cameras, height, width, 1)
        self.visible, self.entries = _joined(visible, cameras, -1), sum(entries)

    def _of_camera(self, camera):
        return self.arrays[camera if self.call.per_camera else 0]

    def backward(self, by_images, names, wanted):
        """Those of the wanted gradients that are not 0 by the nature of the call, by the names of the arguments.

        `by_images` are the gradients of image and alpha, in their shapes; `None` is 0. Errors give them these `names`.
        """
        of_each = []
        for c, kept in enumerate(self.passes):
            by = [None if by is None else _for_core(by[c]) for by in by_images]
            try:
                with self.turn:
                    of_each.append(kept.backward(self._of_camera(c), *by, wanted))
            except Error as error:
                raise Error(_not_finite(by, names, c) or f"camera {c}: {error}") from None
        return {name: self._of_all(name, [np.asarray(by[name]) for by in of_each]) for name in of_each[0]}

    def _of_all(self, name, parts):
        """A gradient by all cameras from those by each."""
        if name in _OF_CAMERAS:
            return _joined(parts, len(parts), *_OF_CAMERAS[name])
        held = self.held[name]
        if len(parts) == 1 and parts[0].size == held.size:
            return parts[0].reshape(held.shape)
        found = np.zeros_like(held)
        for c, part in enumerate(parts):
            target = self.call.colors_of(found, c) if name == "colors" else found
            target += part.reshape(target.shape)
        return found


_OF_CAMERAS = {"viewmats": (4, 4), "Ks": (3, 3), "backgrounds": (-1,)}
"""Arguments of each camera, with the shape of one."""


def _not_finite(by_images, names, camera):
    """Which number of the gradients of a camera's image and alpha is not finite; the core knows the pixel alone."""
    for name, by in zip(names, by_images):
        if by is not None and not np.isfinite(by).all():
            y, x, channel = np.argwhere(~np.isfinite(by))[0]
            return f"{name}: channel {channel} of pixel ({x}, {y}) of camera {camera} is not finite"
    return None


class _Backward:
    """`meta["backward"]`. Pickled, it leaves its pass behind, which belongs to the process."""

    names = ("by_colors", "by_alphas")

    def __init__(self, done=None, wanted=None, zeros=None):
        self.done, self.wanted, self.zeros = done, wanted, zeros

    def __reduce__(self):
        return _Backward, ()

    def __copy__(self):
        return self

    def __deepcopy__(self, memo):
        return self

    def __call__(self, by_colors=None, by_alphas=None):
        """Gradients by the names of the arguments, from those of the images (as returned; `None` is 0)."""
        if self.done is None:
            raise Error("backward: was pickled, and the pass stays in the process that rendered")
        dtype, shape = self.done.image.dtype, self.done.call.shape
        named = dict(zip(self.names, (by_colors, by_alphas)))
        by = [None if by is None else _array(name, by, dtype) for name, by in named.items()]
        for name, array, last in zip(self.names, by, (shape[3], 1)):
            if array is not None:
                _shape(name, array, *shape[:3], last)
        found = self.done.backward(by, self.names, self.wanted)
        return {name: np.zeros_like(of) for name, of in self.zeros.items() if name not in found} | found


def _rasterize_numpy(call, arrays, viewmats, Ks, backgrounds):
    done = _Pass(call, arrays)
    wanted = dict.fromkeys((name for name, array in arrays.items() if array is not None), True)
    behind = np.zeros((call.shape[0], 0)) if backgrounds is None else backgrounds
    zeros = {name: arrays[name] for name in wanted} | {"backgrounds": behind}
    wanted |= {"features": "features" in wanted, "viewmats": True, "Ks": True}
    meta = call.meta(done.visible, done.entries)
    meta["backward"] = _Backward(done, wanted, zeros)
    return done.image, done.alpha, meta


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
    quats        (N, 4), `w x y z`, of any finite length but 0
    scales       (N, 3), standard deviations
    opacities    (N,), in 0..1
    colors       (N, D) or (C, N, D), any D, finite; with `sh_degree` SH coefficients, (N, K, 3) or (C, N, K, 3)
    viewmats     (C, 4, 4), world to camera, rigid
    Ks           (C, 3, 3), pixels
    sh_degree    0 to 3, at most what K holds
    near_plane   least z-depth of a centre, 0 or more; far_plane may be infinite
    backgrounds  (C, D); ignored where no colours are shown
    render_mode  `RGB`, `D` (accumulated z-depth), `ED` (expected), `RGB+D`, `RGB+ED`
    rasterize_mode   `classic`, or `antialiased` (Mip-Splatting)
    camera_model     `pinhole`, or `fisheye` (OpenCV's, with `k1..k4` in `radial_coeffs` (C, 4); 0 without)
    features     not gsplat's: (N, E), finite: further channels of every Gaussian after the colours

    Returns `(render_colors, render_alphas, meta)`: (C, height, width, D + E + depth), (C, height, width, 1), and a
    `Meta`: `visible` (C, N), `tile_entries`. Gradients go to all arrays, also to `viewmats` (that part of the gradient
    which is tangent to the rigid motions), `Ks` and `backgrounds`. With numpy, `meta["backward"](by_colors, by_alphas)`
    returns them as a dict; a pickled `meta` has no pass to go back through.

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
        try:
            fits = value is usual or (usual is not None and bool(value == usual))
        except (TypeError, ValueError, RuntimeError):
            # An array, of which nobody knows whether it equals a number.
            fits = False
        _refuse_unless(fits, "{}: only {} is here, this core has no other", name, usual)
    shutter = getattr(rolling_shutter, "name", rolling_shutter)
    _refuse_unless(shutter in (None, "GLOBAL"), "rolling_shutter: only a global shutter is here")
    _refuse_unless(rasterize_mode in ("classic", "antialiased"), "rasterize_mode: {!r} is neither classic nor antialiased", rasterize_mode)
    _refuse_unless(camera_model in ("pinhole", "fisheye"), "camera_model: {!r} is neither pinhole nor fisheye", camera_model)
    is_fisheye = camera_model == "fisheye"
    _refuse_unless(is_fisheye or radial_coeffs is None, "radial_coeffs: only a fisheye has them here")
    for name, value in (("width", width), ("height", height)):
        pixels = _number(name, value)
        _refuse_unless(1 <= pixels <= 16384, "{}: {} is not within 1 to 16384", name, value)
        _refuse_unless(pixels == int(pixels), "{}: {} is not a whole number", name, value)
    near_plane, far_plane = _number("near_plane", near_plane), _number("far_plane", far_plane)
    eps2d = _number("eps2d", eps2d)
    for name, value, fits in (
        ("near_plane", near_plane, 0 <= near_plane < math.inf),
        ("far_plane", far_plane, far_plane > near_plane),
        ("eps2d", eps2d, 0 <= eps2d < math.inf),
    ):
        _refuse_unless(fits, "{}: {} is out of range", name, value)
    plan = {
        # The core wants a positive one.
        "near_plane": max(near_plane, _LEAST_DEPTH),
        "far_plane": far_plane,
        "eps2d": eps2d,
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
    for name, value in (arrays | {"viewmats": viewmats, "Ks": Ks}).items():
        _refuse_unless(value is not None or name == "features", "{}: is None", name)
    prepared, render = _through(_is_tensor(means))
    arrays, viewmats, Ks, backgrounds, radial_coeffs = prepared(arrays, viewmats, Ks, backgrounds, radial_coeffs)
    if is_fisheye and radial_coeffs is None:
        radial_coeffs = np.zeros((viewmats.shape[0], 4))
    call = _Call(
        arrays, viewmats, Ks, backgrounds, int(width), int(height), sh_degree, render_mode, radial_coeffs, plan
    )
    return render(call, arrays, viewmats, Ks, backgrounds)


def _is_tensor(array):
    """Whether it is one of torch, which is not imported for that."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(array, getattr(torch, "Tensor", ()))


@functools.cache
def _through(is_tensor):
    """What checks and what renders tensors, or arrays of numpy."""
    if is_tensor:
        from ._torch import prepared, render

        return prepared, render
    return _prepared_numpy, _rasterize_numpy


def _prepared_numpy(arrays, viewmats, Ks, backgrounds, radial_coeffs):
    dtype = _array("means", arrays["means"]).dtype
    _refuse_unless(dtype in (np.float32, np.float64), "means: {} is neither float32 nor float64", dtype)

    def checked(name, array):
        if array is None:
            return None
        array = _array(name, array)
        _refuse_unless(array.dtype == dtype, "{}: is {}, means are {}", name, array.dtype, dtype)
        return array

    arrays = {name: checked(name, array) for name, array in arrays.items()}
    named = {"viewmats": viewmats, "Ks": Ks, "backgrounds": backgrounds, "radial_coeffs": radial_coeffs}
    return arrays, *(None if array is None else _array(name, array) for name, array in named.items())
