"""Forward and backward passes of 20,000 Gaussians at 256x256: through torch, of the core alone, and of gsplat's formulas
in plain torch, in turn in one run. Prints the medians and the two ratios, of medians.

    python benchmarks/rasterize.py [--rounds 60] [--formulas 5] [--gaussians 20000] [--side 256] [--sh-degree 1]
"""

import argparse
import os
import statistics
import time

# Threads of torch that have nothing to do sleep: polling, they would slow down what is measured after them, which is the
# core alone.
os.environ |= {"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "0"}

import numpy as np
import reference
import torch
from scene import tube

import respire_bench
from respire_bench import _native
from respire_bench.splat import _Call

NAMES = ("means", "quats", "scales", "opacities", "colors")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--formulas", type=int, default=5, help="how often the formulas run")
    parser.add_argument("--gaussians", type=int, default=20_000)
    parser.add_argument("--side", type=int, default=256)
    parser.add_argument("--sh-degree", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(len(os.sched_getaffinity(0)))
    scene = tube(arguments.gaussians, arguments.side, arguments.sh_degree)
    side, degree = arguments.side, arguments.sh_degree
    leaves = {name: torch.from_numpy(scene[name]).requires_grad_() for name in NAMES}
    camera = {name: torch.from_numpy(scene[name]) for name in ("viewmats", "Ks")}
    rest = {"width": side, "height": side, "sh_degree": degree, "near_plane": 0.2}
    by_image = torch.from_numpy(np.random.default_rng(2).uniform(-1, 1, (1, side, side, 3)).astype(np.float32))

    def forget():
        for leaf in leaves.values():
            leaf.grad = None

    def through_torch():
        forget()
        start = time.perf_counter()
        image, _, _ = respire_bench.rasterize(**leaves, **camera, **rest)
        image.backward(by_image)
        return time.perf_counter() - start

    arrays = {name: scene[name] for name in NAMES} | {"features": None}
    plan = {"near_plane": 0.2, "far_plane": 1e10, "eps2d": 0.3, "antialiased": False}
    plan = _Call(arrays, scene["viewmats"], scene["Ks"], None, side, side, degree, "RGB", None, plan).plans[0]
    wanted = dict.fromkeys(NAMES, True) | dict.fromkeys(("features", "viewmats", "Ks"), False)

    def core_alone():
        return _native.time_core(arrays, plan, by_image.numpy(), wanted)[1]

    def formulas():
        forget()
        start = time.perf_counter()
        image, _ = reference.rasterize(
            *leaves.values(), camera["viewmats"][0], camera["Ks"][0], side, side, sh_degree=degree, near_plane=0.2
        )
        image.backward(by_image[0])
        return time.perf_counter() - start

    times = {through_torch: [], core_alone: [], formulas: []}
    for measured in (through_torch, core_alone):
        measured()
    for _ in range(arguments.rounds):
        for measured in (through_torch, core_alone):
            times[measured].append(measured())
    # Last, and apart from the two that are compared closely.
    times[formulas] = [formulas() for _ in range(arguments.formulas)]
    torch_s, core_s, formulas_s = (statistics.median(of) for of in times.values())
    print(f"{arguments.gaussians} Gaussians, {side}x{side}, SH degree {degree}, torch {torch.__version__}, "
          f"{torch.get_num_threads()} threads, forward and backward")
    print(f"through torch      {1e3 * torch_s:9.2f} ms")
    print(f"the core alone     {1e3 * core_s:9.2f} ms")
    print(f"formulas in torch  {1e3 * formulas_s:9.2f} ms")
    print(f"through torch / the core alone: {torch_s / core_s:.3f}")
    print(f"formulas in torch / through torch: {formulas_s / torch_s:.1f}")


if __name__ == "__main__":
    main()
