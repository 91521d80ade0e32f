"""gsplat's formulas (1.5.3, classic, pinhole) in plain torch, written independently of the core: what `rasterize` is
compared with, in its numbers (tests) and in its time (`rasterize.py`).

Tile by tile, and dense within a tile, which is faster on a CPU than gsplat's own torch code: that goes over lists of
pairs in Python and needs its CUDA kernels to find them.
"""

import torch

TILE = 16


def rotations(quats):
    """(N, 3, 3) from `w x y z` of any length."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, -1).view(-1, 3, 3)


def project(means, quats, scales, viewmat, K, width, height, eps2d):
    """Centres in pixels (N, 2), conics (N, 3), z-depths (N,), covariances in pixels (N, 3)."""
    R, t = viewmat[:3, :3], viewmat[:3, 3]
    p = means @ R.T + t
    M = R @ (rotations(quats) * scales[:, None, :])
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    z = p[:, 2]
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    u = torch.clamp(p[:, 0] / z, -cx / fx - margin_x, (width - cx) / fx + margin_x)
    v = torch.clamp(p[:, 1] / z, -cy / fy - margin_y, (height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    J = torch.stack([fx / z, zero, -fx * u / z, zero, fy / z, -fy * v / z], -1).view(-1, 2, 3)
    S = J @ M
    cov = S @ S.transpose(1, 2)
    a, b, c = cov[:, 0, 0] + eps2d, cov[:, 0, 1], cov[:, 1, 1] + eps2d
    det = a * c - b * b
    centers = torch.stack([fx * p[:, 0] / z + cx, fy * p[:, 1] / z + cy], -1)
    return centers, torch.stack([c / det, -b / det, a / det], -1), z, torch.stack([a, b, c], -1)


def harmonics(degree, directions, coefficients):
    """Colours (N, 3) of SH coefficients (N, K, 3) along unit vectors, before the clamp at 0."""
    x, y, z = directions.unbind(-1)
    b = [torch.full_like(x, 0.28209479177387814)]
    if degree > 0:
        b += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if degree > 1:
        b += [1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (3 * z * z - 1)]
        b += [-1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y)]
    if degree > 2:
        b += [-0.5900435899266435 * y * (3 * x * x - y * y), 2.890611442640554 * x * y * z]
        b += [-0.4570457994644658 * y * (5 * z * z - 1), 0.3731763325901154 * z * (5 * z * z - 3)]
        b += [-0.4570457994644658 * x * (5 * z * z - 1), 1.445305721320277 * z * (x * x - y * y)]
        b += [-0.5900435899266435 * x * (x * x - 3 * y * y)]
    return (torch.stack(b, -1)[..., None] * coefficients[:, : len(b)]).sum(1)


def rasterize(means, quats, scales, opacities, colors, viewmat, K, width, height, *, near_plane=0.01, eps2d=0.3,
              sh_degree=None, background=None, largest_alpha=0.99):
    """Image (height, width, D) and alpha (height, width, 1) of one camera. gsplat's `largest_alpha` is 0.999."""
    centers, conics, depths, covs = project(means, quats, scales, viewmat, K, width, height, eps2d)
    if sh_degree is not None:
        eye = -viewmat[:3, :3].T @ viewmat[:3, 3]
        directions = torch.nn.functional.normalize(means - eye, dim=-1)
        colors = torch.clamp_min(harmonics(sh_degree, directions, colors) + 0.5, 0)
    with torch.no_grad():
        # Half sides of the boxes in which alpha is at least 1/255.
        reach = 2 * torch.log((opacities * 255).clamp_min(1))
        half_x, half_y = (reach * covs[:, 0]).sqrt(), (reach * covs[:, 2]).sqrt()
        shown = (depths > near_plane) & (opacities > 1 / 255)
        order = torch.argsort(depths)
        order = order[shown[order]]
        left, right = centers[:, 0] - half_x, centers[:, 0] + half_x
        top, bottom = centers[:, 1] - half_y, centers[:, 1] + half_y
    rows = []
    for y in range(0, height, TILE):
        in_row = order[(bottom[order] > y) & (top[order] < y + TILE)]
        tiles = []
        for x in range(0, width, TILE):
            tile = in_row[(right[in_row] > x) & (left[in_row] < x + TILE)]
            h, w = min(TILE, height - y), min(TILE, width - x)
            py = torch.arange(y, y + h, dtype=means.dtype) + 0.5
            px = torch.arange(x, x + w, dtype=means.dtype) + 0.5
            dx = px.repeat(h)[:, None] - centers[tile, 0]
            dy = py.repeat_interleave(w)[:, None] - centers[tile, 1]
            a, b, c = conics[tile].unbind(-1)
            alpha = opacities[tile] * torch.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy)
            alpha = torch.clamp_max(alpha, largest_alpha)
            alpha = torch.where(alpha < 1 / 255, torch.zeros_like(alpha), alpha)
            after = torch.cumprod(1 - alpha, 1)
            # A pixel stops at the Gaussian that would leave 1e-4 of the light.
            kept = torch.where(after > 1e-4, alpha, torch.zeros_like(alpha))
            after = torch.cumprod(1 - kept, 1)
            before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], 1)
            weights = kept * before
            total = weights.sum(1, keepdim=True)
            color = weights @ colors[tile]
            if background is not None:
                color = color + (1 - total) * background
            tiles.append(torch.cat([color, total], 1).view(h, w, -1))
        rows.append(torch.cat(tiles, 1))
    image = torch.cat(rows, 0)
    return image[..., :-1], image[..., -1:]
