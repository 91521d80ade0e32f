"""Trains free Gaussians on the first frame of a film with torch's Adam.

python train_gaussians.py FILM [STEPS]    FILM: a film's folder or a participant's
"""

import sys

import numpy as np
import torch

import respire_bench as rb

film = rb.load(sys.argv[1])
steps = int(sys.argv[2]) if len(sys.argv) > 2 else 200
image = torch.from_numpy(film.images[0]).float() / 255
camera = dict(width=film.width, height=film.height, Ks=torch.tensor(film.K)[None])
camera["viewmats"] = torch.from_numpy(np.linalg.inv(film.poses[0]))[None]
if film.fisheye is not None:
    camera |= dict(camera_model="fisheye", radial_coeffs=torch.tensor(film.fisheye)[None])

# One Gaussian on the surface seen in every second pixel of every second row.
v, u = np.argwhere(film.depths_mm[0][::2, ::2] > 0).T * 2
depth = film.depths_mm[0][v, u]
x, y = (u + 0.5 - film.K[0, 2]) / film.K[0, 0], (v + 0.5 - film.K[1, 2]) / film.K[1, 1]
if film.fisheye is not None:
    # The angle off the axis whose image is that far from the centre, by iteration.
    distorted, k = np.hypot(x, y), film.fisheye
    theta = distorted
    for _ in range(50):
        theta = distorted / (1 + k[0] * theta**2 + k[1] * theta**4 + k[2] * theta**6 + k[3] * theta**8)
    x, y = (np.tan(theta) / np.maximum(distorted, 1e-9) * axis for axis in (x, y))
points = np.stack([x, y, np.ones_like(x)], -1) * depth[:, None]
points = points @ film.poses[0][:3, :3].T + film.poses[0][:3, 3]
n = len(points)
parameters = {
    "means": torch.from_numpy(points).float(),
    "quats": torch.tensor([1.0, 0, 0, 0]).repeat(n, 1),
    "scales": torch.from_numpy(np.log(1.5 * depth / film.K[0, 0])).float()[:, None].repeat(1, 3),
    "opacities": torch.zeros(n),
    "colors": torch.full((n, 3), 0.5),
}
rates = {"means": 0.01, "quats": 0.01, "scales": 0.02, "opacities": 0.05, "colors": 0.02}
for parameter in parameters.values():
    parameter.requires_grad_()
adam = torch.optim.Adam([{"params": [parameters[name]], "lr": rate} for name, rate in rates.items()])
for step in range(steps + 1):
    activated = parameters | {"scales": parameters["scales"].exp(), "opacities": parameters["opacities"].sigmoid()}
    shown, _, _ = rb.rasterize(**activated, **camera)
    loss = (shown[0] - image).square().mean()
    if step in (0, steps):
        print(f"step {step}: {-10 * loss.log10().item():.2f} dB with {n} Gaussians")
    adam.zero_grad()
    loss.backward()
    adam.step()
