from typing import Any, Literal, TypeVar

# A torch.Tensor or an array of numpy; all of one call are of one kind.
_Array = TypeVar("_Array")

class Meta(dict[str, Any]): ...

def rasterize(
    means: _Array,
    quats: _Array,
    scales: _Array,
    opacities: _Array,
    colors: _Array,
    viewmats: _Array,
    Ks: _Array,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: _Array | None = None,
    render_mode: Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"] = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: Literal["classic", "antialiased"] = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: Literal["pinhole", "fisheye"] = "pinhole",
    segmented: bool = False,
    covars: None = None,
    with_ut: bool = False,
    with_eval3d: bool = False,
    radial_coeffs: _Array | None = None,
    tangential_coeffs: None = None,
    thin_prism_coeffs: None = None,
    ftheta_coeffs: None = None,
    rolling_shutter: Any = None,
    viewmats_rs: None = None,
    *,
    features: _Array | None = None,
) -> tuple[_Array, _Array, Meta]: ...
