"""`rasterize` as a `torch.autograd.Function`. Tensors are handed to the core as they lie in memory."""

import numpy as np
import torch

from ._native import Error, forward
from .splat import _matrix_of_intrinsics

_NAMES = ("means", "quats", "scales", "opacities", "colors", "features")


def _checked(name, tensor, dtype):
    if tensor is None:
        return None
    if not isinstance(tensor, torch.Tensor):
        raise Error(f"{name}: is no tensor, as means are")
    if tensor.device.type != "cpu":
        raise Error(f"{name}: is on {tensor.device}; this core renders on the CPU")
    if tensor.dtype != dtype:
        raise Error(f"{name}: is {tensor.dtype}, means are {dtype}")
    return tensor


def prepared(arrays, viewmats, Ks, backgrounds, radial_coeffs):
    """The arguments of a call, checked for type and place."""
    dtype = arrays["means"].dtype
    if dtype not in (torch.float32, torch.float64):
        raise Error(f"means: {dtype} is neither float32 nor float64")
    arrays = {name: _checked(name, tensor, dtype) for name, tensor in arrays.items()}
    named = {"viewmats": viewmats, "Ks": Ks, "backgrounds": backgrounds, "radial_coeffs": radial_coeffs}
    # A camera may be of another type than the Gaussians: it is computed with in double precision.
    rest = [_checked(name, t, t.dtype if isinstance(t, torch.Tensor) else None) for name, t in named.items()]
    if rest[3] is not None and rest[3].requires_grad:
        raise Error("radial_coeffs: this core has no gradient of them")
    return arrays, *rest


def _numpy(tensor):
    """The memory of a tensor as an array."""
    return None if tensor is None else tensor.detach().contiguous().numpy()


class _Rasterize(torch.autograd.Function):
    """One camera."""

    @staticmethod
    def forward(ctx, call, camera, told, viewmat, K, background, *tensors):
        arrays = dict(zip(_NAMES, map(_numpy, tensors)))
        plan = call.of_camera(camera, _numpy(viewmat), _numpy(K), _numpy(background))
        kept, image, alpha, visible, entries = forward(arrays, plan)
        told.append((visible, entries))
        if any(ctx.needs_input_grad):
            ctx.kept = kept
        # Raises in `backward` where a tensor has been changed in place since.
        ctx.save_for_backward(viewmat, K, background, *tensors)
        height, width = call.size
        ctx.set_materialize_grads(False)
        return (
            torch.from_numpy(image).view(height, width, sum(call.widths)),
            torch.from_numpy(alpha).view(height, width, 1),
        )

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, by_image, by_alpha):
        viewmat, K, background, *tensors = ctx.saved_tensors
        needs = ctx.needs_input_grad[3:]
        wanted = dict(zip(_NAMES, needs[3:])) | {"viewmats": needs[0], "Ks": needs[1]}
        if by_image is None:
            by_image = torch.zeros(0, dtype=tensors[0].dtype)
        found = ctx.kept.backward(dict(zip(_NAMES, map(_numpy, tensors))), _numpy(by_image), _numpy(by_alpha), wanted)

        def like(tensor, values, needed):
            if not needed or values is None:
                return None
            return torch.from_numpy(np.asarray(values)).to(tensor.dtype).view(tensor.shape)

        by_K = _matrix_of_intrinsics(found["Ks"])
        camera = [
            like(viewmat, found["viewmats"], needs[0]),
            like(K, by_K, needs[1]),
            like(background, found["backgrounds"], needs[2]) if background is not None else None,
        ]
        of_gaussians = [like(t, found.get(name), needed) for name, t, needed in zip(_NAMES, tensors, needs[3:])]
        return (None, None, None, *camera, *of_gaussians)


def render(call, arrays, viewmats, Ks, backgrounds):
    """All cameras of a call."""
    images, alphas, told = [], [], []
    for c in range(call.cameras):
        colors = call.colors_of(arrays["colors"], c)
        tensors = [colors if name == "colors" else arrays[name] for name in _NAMES]
        background = None if backgrounds is None else backgrounds[c]
        image, alpha = _Rasterize.apply(call, c, told, viewmats[c], Ks[c], background, *tensors)
        images.append(image)
        alphas.append(alpha)
    one = call.cameras == 1
    image = images[0][None] if one else torch.stack(images)
    alpha = alphas[0][None] if one else torch.stack(alphas)
    visible = torch.from_numpy(np.stack([visible for visible, _ in told]))
    return image, alpha, call.meta(visible, sum(entries for _, entries in told))
