"""`rasterize` as a `torch.autograd.Function`. Tensors are handed to the core as they lie in memory."""

import torch

from ._native import Error
from .splat import _Pass

_NAMES = ("viewmats", "Ks", "backgrounds", "means", "quats", "scales", "opacities", "colors", "features")
"""The arguments of `_Rasterize`, in order."""


_GRADIENTS = ("the gradient of render_colors", "the gradient of render_alphas")
"""What errors call the gradients of the images."""


def _checked(name, tensor, dtype):
    if tensor is None:
        return None
    if not isinstance(tensor, torch.Tensor):
        raise Error(f"{name}: is no tensor, as means are")
    if not tensor.is_cpu:
        raise Error(f"{name}: is on {tensor.device}; this core renders on the CPU")
    if tensor.layout != torch.strided:
        raise Error(f"{name}: is sparse; only a dense tensor lies as the core reads it")
    if tensor.is_complex():
        raise Error(f"{name}: is complex")
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
    return None if tensor is None else tensor.detach().resolve_neg().numpy()


class _Rasterize(torch.autograd.Function):
    """What autograd has to know of a pass that is done: its images, and how their gradients go on."""

    @staticmethod
    def forward(ctx, done, *tensors):
        if any(ctx.needs_input_grad):
            ctx.done = done
        ctx.save_for_backward(*tensors)
        ctx.set_materialize_grads(False)
        return torch.from_numpy(done.image), torch.from_numpy(done.alpha)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, by_image, by_alpha):
        # Raises where a tensor has been changed in place since.
        tensors = ctx.saved_tensors
        needed = dict(zip(_NAMES, ctx.needs_input_grad[1:]))
        found = ctx.done.backward((_numpy(by_image), _numpy(by_alpha)), _GRADIENTS, needed)
        return None, *(
            # The camera may be of another type than its gradient.
            torch.from_numpy(found[name]).to(tensor.dtype) if needed[name] and name in found else None
            for name, tensor in zip(_NAMES, tensors)
        )


def render(call, tensors, viewmats, Ks, backgrounds):
    """All cameras of a call."""
    done = _Pass(call, {name: _numpy(tensor) for name, tensor in tensors.items()})
    image, alpha = _Rasterize.apply(done, viewmats, Ks, backgrounds, *tensors.values())
    return image, alpha, call.meta(torch.from_numpy(done.visible), done.entries)
