"""From film to scored row: the CT surface breathes as a sine and is painted, frame by frame.
python own_method.py BLIND ANSWER   (BLIND: `respire-bench simulate CASE --blind BLIND`)"""
import sys
import time

import numpy as np

import respire_bench as rb

blind, answer = sys.argv[1:]
film = rb.load(f"{blind}/participant")
(rest, faces), expired = film.inspiration, film.expiration.vertices
phase = 0.5 - 0.5 * np.cos(2 * np.pi * np.maximum(film.times_s - 0.5, 0) / film.breathing_period_s)  # films begin at rest
edge = np.linalg.norm(rest[faces[:, 0]] - rest[faces[:, 1]], axis=1).mean()
corners = np.random.default_rng(0).dirichlet([1, 1, 1], 6)  # six Gaussians on every face
n, f32 = 6 * len(faces), np.float32
fixed = {"quats": np.tile(f32([1, 0, 0, 0]), (n, 1)), "scales": np.full((n, 3), 0.15 * edge, f32),
         "opacities": np.full(n, 0.95, f32), "Ks": film.K[None], "width": film.width, "height": film.height,
         "near_plane": 0.5, "render_mode": "RGB+ED"}
if film.fisheye is not None:
    fixed |= {"camera_model": "fisheye", "radial_coeffs": film.fisheye[None]}
colors = np.full((n, 3), 0.3, f32)

def render(i):  # the surface at frame i, in the colours so far
    surface = (1 - phase[i]) * rest + phase[i] * expired
    means = f32(np.einsum("fci,wc->fwi", surface[faces], corners)).reshape(n, 3)
    image, _, meta = rb.rasterize(means, colors=colors, viewmats=np.linalg.inv(film.poses[i])[None], **fixed)
    return image[..., :3], image[0, ..., 3], lambda by: meta["backward"](np.pad(by, [(0, 0)] * 3 + [(0, 1)]))["colors"]

start, color, depth, ahead = time.perf_counter(), [], [], {}
for i, frame in enumerate(film.images):
    ahead[i], _, to_colors = render(i)
    colors += to_colors(f32(frame / 255) - ahead[i]) / (to_colors(np.ones_like(ahead[i])) + f32(0.1))
    image, z, _ = render(i)
    color, depth = [*color, image[0]], [*depth, z]
rb.write_prediction(answer, film, color, depth_mm=depth, phase=phase, method="painted-mesh",
                    ahead={i: ahead[i][0] for i in film.held_out_frames},
                    mesh=((1 - phase[-1]) * rest + phase[-1] * expired, faces), time_total_s=time.perf_counter() - start)
print(*(f"{name:30}{value}" for name, value in rb.evaluate(f"{blind}/truth", answer)[1].items()), sep="\n")
