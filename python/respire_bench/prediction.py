"""A folder of predictions, as `respire-bench check` and `evaluate` want it (docs/predictions.md)."""

import os
from collections.abc import Mapping

import numpy as np

from ._native import Error, PredictionFolder
from .film import Film


_MOST_OF_A_FLOAT = 8
"""Floats above it are no encoded values in 0..1, whatever a rendering overshoots by: most likely 0..255."""


def _array(what, value):
    """An array of numbers."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:
        # Of a ragged list, or of a tensor with a gradient; the first sentence says so.
        raise Error(f"{what}: is no array: {str(error).partition('. ')[0]}") from None
    if array.dtype.kind not in "biuf":
        found = repr(value) if array.dtype.kind == "O" else array.dtype
        raise Error(f"{what}: wanted numbers, not {found!s:.80}")
    return array


def _numbers(what, value, shape, dtype=np.float64):
    return np.ascontiguousarray(_checked(what, _array(what, value), shape), dtype=dtype).reshape(shape)


def _picture(what, image, film):
    image = _array(what, image)
    if image.dtype != np.uint8:
        if image.dtype.kind != "f":
            raise Error(f"{what}: wanted 8-bit sRGB or encoded values in 0..1, not {image.dtype}")
        # NaN becomes 0, as in the program's own predictions.
        image = image.astype(np.promote_types(image.dtype, np.float32))
        image[np.isnan(image)] = 0
        if image.size and image.max() > _MOST_OF_A_FLOAT:
            raise Error(f"{what}: has {image.max():g}; floats are in 0..1")
        image = (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
    return np.ascontiguousarray(_checked(what, image, (film.height, film.width, 3)))


def _checked(what, array, shape):
    if array.shape != shape:
        raise Error(f"{what}: has shape {array.shape} instead of {shape}")
    return array


def _numbered(name, values, frames):
    """Pairs of a frame and its value, in order, from a dict or from one value for each of `frames`."""
    if values is None:
        return
    if isinstance(values, Mapping):
        if set(values) != set(frames):
            raise Error(f"{name}: wanted the frames {list(frames)}, not {list(values)}")
        for frame in frames:
            yield frame, values[frame]
        return
    try:
        each = iter(values)
    except TypeError:
        raise Error(f"{name}: wanted a value for each of {len(frames)} frames, not {values!r:.80}") from None
    count = -1
    for count, value in enumerate(each):
        if count >= len(frames):
            raise Error(f"{name}: has more than the {len(frames)} values that are wanted")
        yield frames[count], value
    if count + 1 != len(frames):
        raise Error(f"{name}: has {count + 1} values, {len(frames)} are wanted")


def _seconds(name, value):
    if value is None:
        return None
    seconds = float(_numbers(name, value, ()))
    if not 0 < seconds < float("inf"):
        raise Error(f"{name}: {seconds} is not above 0")
    return seconds


def _covariances(what, value, targets):
    """(n, 9), each symmetric and positive definite, to the digits that are written."""
    found = np.round(_numbers(what, value, (targets, 3, 3)), 9)
    symmetric = np.abs(found - found.swapaxes(1, 2)) <= 1e-9 + 1e-6 * np.abs(found)
    sound = symmetric.all((1, 2))
    # The upper triangle is what is written.
    upper = np.triu(np.where(sound[:, None, None], found, -np.eye(3)))
    whole = upper + np.triu(upper, 1).swapaxes(1, 2)
    for size in (1, 2, 3):
        sound &= np.linalg.det(whole[:, :size, :size]) > 0
    if not sound.all():
        raise Error(f"{what}: that of target {int(np.argmin(sound))} is no positive definite covariance")
    return whole.reshape(targets, 9)


def _mesh(mesh):
    """Vertices, and faces in a row."""
    if mesh is None:
        return None, None
    try:
        vertices, faces = mesh
    except (TypeError, ValueError):
        raise Error("mesh: wanted a pair of vertices and faces") from None
    vertices, faces = _array("mesh: vertices", vertices), _array("mesh: faces", faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise Error(f"mesh: vertices {vertices.shape} and faces {faces.shape} are not (n, 3) and (m, 3)")
    if faces.dtype.kind not in "iu":
        raise Error(f"mesh: faces are numbers of vertices, not {faces.dtype}")
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise Error(f"mesh: a face names a vertex that is none of the {len(vertices)}")
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    return vertices, np.ascontiguousarray(faces.reshape(-1), dtype=np.uint32)


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
    target_covariance_mm2=None,
    mesh=None,
    method=None,
    time_total_s=None,
    time_cpu_s=None,
):
    """Writes the answer to `film` into `folder`, which must be empty or not there: all of it or, after an error, nothing.

    Every argument but `folder`, `film` and `color` may be left out: a metric that needs it is then not applicable.
    What is one per frame may be an array, a list or a generator, which is read one by one; or a dict by frame.

    color, ahead, novel      renderings (height, width, 3): 8-bit sRGB, or floats in 0..1 of the same encoding (NaN is
                             0); of every frame, of `film.held_out_frames`, of the cameras of `film.novel_frames`
    depth_mm, novel_depth_mm z-depth (height, width) in mm, 0 = none, with `color` and `novel`
    phase, phase_sd          breathing phase of every frame, 0 full inspiration, 1 full expiration; standard deviation
    poses                    (frames, 4, 4), world from camera in mm, of a method with poses of its own
    targets_mm               (frames, n, 3), where the film's targets are
    target_covariance_mm2    (frames, n, 3, 3), how surely, in the camera's axes
    mesh                     vertices (n, 3) in mm and faces (m, 3) of the surface at the last frame
    method                   its name in tables, none of the program's own
    time_total_s, time_cpu_s what the method alone took: wall and CPU seconds

    Raises `Error`, one sentence that names the argument and the frame.
    """
    if not isinstance(film, Film):
        raise Error(f"film: wanted what load(..) returns, not {film!r:.80}")
    if color is None:
        raise Error("color: is None; a rendering of every frame is wanted")
    every, held_out, views = range(len(film)), film.held_out_frames, film.novel_frames
    if not len(views) and (novel is not None or novel_depth_mm is not None):
        raise Error("novel: the film has no second camera")
    if phase_sd is not None and phase is None:
        raise Error("phase_sd: is given without phase")
    if time_total_s is None and time_cpu_s is not None:
        raise Error("time_cpu_s: is given without time_total_s")
    if targets_mm is None and target_covariance_mm2 is not None:
        raise Error("target_covariance_mm2: is given without targets_mm")
    if not (method is None or isinstance(method, str)):
        raise Error(f"method: wanted a name, not {method!r:.80}")
    time_total_s, time_cpu_s = _seconds("time_total_s", time_total_s), _seconds("time_cpu_s", time_cpu_s)
    out = PredictionFolder(os.fspath(folder), method)
    try:
        for kind, values, frames in (("color", color, every), ("ahead", ahead, held_out), ("novel", novel, views)):
            for frame, image in _numbered(kind, values, frames):
                out.picture(kind, frame, _picture(f"{kind}, frame {frame}", image, film))
        for kind, name, values, frames in (
            ("depth", "depth_mm", depth_mm, every),
            ("novel_depth", "novel_depth_mm", novel_depth_mm, views),
        ):
            for frame, depth in _numbered(name, values, frames):
                what = f"{name}, frame {frame}"
                out.depth(kind, frame, _numbers(what, depth, (film.height, film.width), np.float32))
        deviations = {
            frame: float(_numbers(f"phase_sd, frame {frame}", value, ()))
            for frame, value in _numbered("phase_sd", phase_sd, every)
        }
        for frame, value in _numbered("phase", phase, every):
            out.phase(frame, float(_numbers(f"phase, frame {frame}", value, ())), deviations.get(frame))
        for frame, pose in _numbered("poses", poses, every):
            out.pose(frame, _numbers(f"poses, frame {frame}", pose, (4, 4)))
        for frame, places in _numbered("targets_mm", targets_mm, every):
            out.targets(frame, _numbers(f"targets_mm, frame {frame}", places, film.targets_mm.shape))
        for frame, value in _numbered("target_covariance_mm2", target_covariance_mm2, every):
            what = f"target_covariance_mm2, frame {frame}"
            out.target_covariances(frame, _covariances(what, value, len(film.targets_mm)))
        out.finish(len(film), *_mesh(mesh), time_total_s, time_cpu_s)
    except BaseException:
        # A kept traceback keeps `out` alive, as every notebook does.
        out.abandon()
        raise
