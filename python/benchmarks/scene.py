"""The scene of the timings, as in `src/splat/check/tube.rs`: a bumpy tube of thin Gaussians, seen from inside."""

import numpy as np


def tube(n=20_000, side=256, sh_degree=1, seed=1):
    """Arguments of `rasterize` as float32 arrays of numpy."""
    r = np.random.default_rng(seed)
    around, length = 2 * np.pi * 8.0, 100.0
    spacing = np.sqrt(around * length / n)
    columns = max(1, round(around / spacing))
    rows = -(-n // columns)
    i = np.arange(n)
    row, column = i // columns, i % columns
    angle = ((column + 0.5 * (row % 2)) * around / columns + 0.15 * spacing * r.standard_normal(n)) / 8.0
    z = (row + 0.5) * length / rows + 0.15 * spacing * r.standard_normal(n)
    radius = 8.0 + 0.3 * np.sin(2 * np.pi * z / 12.0) * (0.6 + 0.4 * np.cos(3 * angle))
    means = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1)
    # The third axis points inwards: the shortest turn from z.
    inwards = np.stack([-np.cos(angle), -np.sin(angle), 0.05 * r.standard_normal(n)], -1)
    inwards /= np.linalg.norm(inwards, axis=-1, keepdims=True)
    quats = np.stack([1 + inwards[:, 2], -inwards[:, 1], inwards[:, 0], 0 * angle], -1)
    size = 0.7 * spacing
    scales = size * np.stack([r.uniform(0.85, 1.15, n), r.uniform(0.85, 1.15, n), np.full(n, 0.05)], -1)
    forward = np.array([np.sin(np.radians(12)), np.sin(np.radians(6)), 1.0])
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, -1, 0])
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    viewmat[:3, 3] = -viewmat[:3, :3] @ [1.0, -0.5, 10.0]
    K = np.array([[side / 2, 0, side / 2], [0, side / 2, side / 2], [0, 0, 1]])
    arrays = {
        "means": means,
        "quats": quats,
        "scales": scales,
        "opacities": np.full(n, 0.95),
        "colors": 0.3 * r.standard_normal((n, (sh_degree + 1) ** 2, 3)),
        "viewmats": viewmat[None],
        "Ks": K[None],
    }
    arrays = {name: np.ascontiguousarray(array, dtype=np.float32) for name, array in arrays.items()}
    return arrays | {"width": side, "height": side, "sh_degree": sh_degree, "near_plane": 0.2}
