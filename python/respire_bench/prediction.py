"""A folder of predictions, as `respire-bench check` and `evaluate` want it (docs/predictions.md)."""

import os

import numpy as np

from ._native import Error, PredictionFolder


def _picture(what, image, film):
    image = np.asarray(image)
    if image.dtype != np.uint8:
        if image.dtype.kind != "f":
            raise Error(f"{what}: wanted 8-bit sRGB or encoded values in 0..1, not {image.dtype}")
        # NaN becomes 0, as in the program's own predictions.
        image = (np.clip(np.nan_to_num(image), 0, 1) * 255 + 0.5).astype(np.uint8)
    return _checked(what, image, (film.height, film.width, 3))


def _checked(what, array, shape):
    if array.shape != shape:
        raise Error(f"{what}: has shape {array.shape} instead of {shape}")
    return np.ascontiguousarray(array)


def _numbered(name, values, frames, film):
    """Pairs of a frame and its value, from a dict or from one value for each of `frames`."""
    if values is None:
        return
    if isinstance(values, dict):
        if sorted(values) != list(frames):
            raise Error(f"{name}: wanted the frames {list(frames)}, not {sorted(values)}")
        yield from values.items()
        return
    count = -1
    for count, value in enumerate(values):
        if count >= len(frames):
            raise Error(f"{name}: has more than the {len(frames)} values that are wanted")
        yield frames[count], value
    if count + 1 != len(frames):
        raise Error(f"{name}: has {count + 1} values, {len(frames)} are wanted")


def write_prediction(
    folder,
    film,
    color,
    *,
    depth_mm=None,
    ahead=None,
    novel=None,
    novel_depth_mm=None,
    phase=None,
    phase_sd=None,
    poses=None,
    targets_mm=None,
    mesh=None,
    method=None,
    time_total_s=None,
    time_cpu_s=None,
):
    """Writes the answer to `film` into `folder`, which must be empty or not there: all of it or, after an error, nothing.

    Every argument but `folder`, `film` and `color` may be left out: a metric that needs it is then not applicable.
    What is one per frame may be an array, a list or a generator, which is read one by one; or a dict by frame.

    color, ahead, novel      renderings (height, width, 3): 8-bit sRGB, or floats in 0..1 of the same encoding; of every
                             frame, of `film.held_out_frames`, of the cameras of `film.novel_frames`
    depth_mm, novel_depth_mm z-depth (height, width) in mm, 0 = none, with `color` and `novel`
    phase, phase_sd          breathing phase of every frame, 0 full inspiration, 1 full expiration; standard deviation
    poses                    (frames, 4, 4), world from camera in mm, of a method with poses of its own
    targets_mm               (frames, n, 3), where the film's targets are
    mesh                     vertices (n, 3) in mm and faces (m, 3) of the surface at the last frame
    method                   its name in tables
    time_total_s, time_cpu_s what the method alone took: wall and CPU seconds

    Raises `Error`, one sentence that names the argument and the frame.
    """
    every, held_out, views = range(len(film)), film.held_out_frames, film.novel_frames
    if not len(views) and (novel is not None or novel_depth_mm is not None):
        raise Error("novel: the film has no second camera")
    if phase_sd is not None and phase is None:
        raise Error("phase_sd: is given without phase")
    if time_total_s is None and time_cpu_s is not None:
        raise Error("time_cpu_s: is given without time_total_s")
    for name, seconds in (("time_total_s", time_total_s), ("time_cpu_s", time_cpu_s)):
        if seconds is not None and not 0 < seconds < float("inf"):
            raise Error(f"{name}: {seconds} is not above 0")
    out = PredictionFolder(os.fspath(folder))
    try:
        for kind, values, frames in (("color", color, every), ("ahead", ahead, held_out), ("novel", novel, views)):
            for frame, image in _numbered(kind, values, frames, film):
                out.picture(kind, frame, _picture(f"{kind}, frame {frame}", image, film))
        for kind, name, values, frames in (
            ("depth", "depth_mm", depth_mm, every),
            ("novel_depth", "novel_depth_mm", novel_depth_mm, views),
        ):
            for frame, depth in _numbered(name, values, frames, film):
                depth = np.asarray(depth, dtype=np.float32)
                out.depth(kind, frame, _checked(f"{name}, frame {frame}", depth, (film.height, film.width)))
        deviations = dict(_numbered("phase_sd", phase_sd, every, film))
        for frame, value in _numbered("phase", phase, every, film):
            deviation = deviations.get(frame)
            if not np.isfinite(value) or (deviation is not None and not 0 < deviation < float("inf")):
                raise Error(f"phase, frame {frame}: {value} with the deviation {deviation} is no phase")
            out.phase(frame, float(value), None if deviation is None else float(deviation))
        for frame, pose in _numbered("poses", poses, every, film):
            out.pose(frame, _checked(f"poses, frame {frame}", np.asarray(pose, dtype=np.float64), (4, 4)))
        for frame, places in _numbered("targets_mm", targets_mm, every, film):
            places = np.asarray(places, dtype=np.float64)
            places = _checked(f"targets_mm, frame {frame}", places, film.targets_mm.shape)
            if not np.isfinite(places).all():
                raise Error(f"targets_mm, frame {frame}: is not finite")
            out.targets(frame, places)
        vertices, faces = (None, None) if mesh is None else mesh
        if mesh is not None:
            vertices = np.ascontiguousarray(vertices, dtype=np.float64)
            faces = np.asarray(faces)
            if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
                raise Error(f"mesh: vertices {vertices.shape} and faces {faces.shape} are not (n, 3) and (m, 3)")
            if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
                raise Error(f"mesh: a face names a vertex that is none of the {len(vertices)}")
            faces = np.ascontiguousarray(faces.reshape(-1), dtype=np.uint32)
        out.finish(len(film), method, vertices, faces, time_total_s, time_cpu_s)
    except BaseException:
        # A kept traceback keeps `out` alive, as every notebook does.
        out.abandon()
        raise
