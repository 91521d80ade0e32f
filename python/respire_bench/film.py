"""A film: what a method may see of it, read when it is used."""

import os
from functools import cached_property, wraps
from typing import NamedTuple

import numpy as np

from ._native import Error
from ._native import Film as _NativeFilm


class TruthHidden(Error, AttributeError):
    """What was asked for is truth, and the film was opened without."""


class Mesh(NamedTuple):
    """A surface: vertices (n, 3) in mm, faces (m, 3) whose normals point into the lumen."""

    vertices: np.ndarray
    faces: np.ndarray


class Frame(NamedTuple):
    """A frame as a method sees it."""

    index: int
    image: np.ndarray
    """(height, width, 3), 8-bit sRGB."""
    time_s: float
    pose: np.ndarray
    """(4, 4), world from camera, mm."""


_READS = {
    "images": ("image", (3,), np.uint8),
    "depths_mm": ("depth_mm", (), np.float32),
    "novel_images": ("novel_image", (3,), np.uint8),
    "novel_depths_mm": ("novel_depth_mm", (), np.float32),
}
"""What a `Lazy` reads: the native method, the shape of a pixel, the type."""


class Lazy:
    """Arrays of one shape, read from disk one by one: `a[3]`, `a[2:9]`, `for x in a`, `numpy.asarray(a)`."""

    def __init__(self, film, name, indices):
        self._film, self._name, self._indices = film, name, indices
        _, pixel, dtype = _READS[name]
        self.shape, self.dtype = (len(indices), film.height, film.width, *pixel), np.dtype(dtype)

    @property
    def ndim(self):
        """Number of dimensions."""
        return len(self.shape)

    def _read(self, index):
        return getattr(self._film._film, _READS[self._name][0])(index)

    def __len__(self):
        return len(self._indices)

    def __getitem__(self, key):
        if isinstance(key, slice):
            return np.asarray(Lazy(self._film, self._name, self._indices[key]))
        try:
            index = self._indices[key]
        except IndexError:
            raise IndexError(f"{self._name}[{key}]: {self._held()}") from None
        return self._read(index)

    def _held(self):
        if self._name.startswith("novel"):
            return f"the frames with a second camera are {list(self._film.novel_frames)}"
        if self._name == "depths_mm" and not self._film.truth:
            return "a method sees the depth of frame 0; load(.., truth=True) opens the others"
        return f"the film has {len(self._film)} frames"

    def __iter__(self):
        return (self._read(index) for index in self._indices)

    def __array__(self, dtype=None, copy=None):
        if copy is False:
            raise ValueError(f"{self._name} are read from files: no array of them is without a copy")
        out = np.empty(self.shape, dtype or self.dtype)
        for place, value in zip(out, self):
            place[...] = value
        return out

    def __repr__(self):
        return f"<{len(self)} arrays of shape {self.shape[1:]}, {self.dtype}, read when used>"


def _matrix_of(intrinsics):
    fl_x, fl_y, cx, cy = intrinsics
    return np.array([[fl_x, 0, cx], [0, fl_y, cy], [0, 0, 1]])


def _of_truth(read):
    """A getter of what only a film with its truth has."""

    @wraps(read)
    def getter(film):
        if not film.truth:
            raise TruthHidden(f"{read.__name__} is truth, which no method may see: load(.., truth=True) opens it")
        return read(film)

    return getter


def _kept(array):
    """An array that is kept: written into, it would be wrong for whoever reads it later."""
    if array is not None:
        array.setflags(write=False)
    return array


def _kept_mesh(arrays):
    return Mesh(*map(_kept, arrays))


class Film:
    """A film. Its length is its number of frames, `film[i]` a `Frame`, `film[2:9]` a list of them.

    Without truth it holds what a method may see and nothing else, whether the folder is a whole film or what
    participants of a blind comparison get. Every file is compared with the hash in the film's manifest first.
    """

    def __init__(self, folder, truth=False):
        # The film stays the same one after a change of directory.
        self.folder = os.path.abspath(os.fspath(folder))
        self.truth = bool(truth)
        self._film = _NativeFilm.open(self.folder, self.truth)
        self.width, self.height = self._film.size

    def __len__(self):
        return self._film.frames

    def __getitem__(self, index):
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        index = self._frame(index)
        return Frame(index, self._film.image(index), float(self.times_s[index]), self.poses[index].copy())

    def __iter__(self):
        return (self[index] for index in range(len(self)))

    def __reduce__(self):
        return type(self), (self.folder, self.truth)

    def _frame(self, index):
        """The number of a frame, which may be counted from the end."""
        try:
            return range(len(self))[index]
        except IndexError:
            raise IndexError(f"frame {index} of a film of {len(self)} frames") from None

    def __repr__(self):
        seen = "with its truth" if self.truth else "as a method sees it"
        return f"<Film {self.folder}: {len(self)} frames of {self.width}x{self.height}, {seen}>"

    @property
    def images(self):
        """Images of all frames: (height, width, 3), 8-bit sRGB."""
        return Lazy(self, "images", range(len(self)))

    @property
    def depths_mm(self):
        """z-depths in mm, 0 where nothing was hit: that of frame 0; with the truth those of all frames."""
        return Lazy(self, "depths_mm", range(len(self) if self.truth else 1))

    @cached_property
    def poses(self):
        """(frames, 4, 4), world from camera, mm."""
        return _kept(self._film.poses)

    @cached_property
    def times_s(self):
        """(frames,), seconds since the first."""
        return _kept(self._film.times_s)

    @cached_property
    def K(self):
        """(3, 3), intrinsics in pixels; pixel centres at integer + 0.5."""
        return _kept(_matrix_of(self._film.intrinsics))

    @cached_property
    def fisheye(self):
        """`k1..k4` of OpenCV's fisheye model; `None` for a pinhole."""
        return self._film.fisheye and _kept(np.array(self._film.fisheye))

    @cached_property
    def mask(self):
        """(height, width), true where pixels count in metrics; `None` where all do."""
        return _kept(self._film.mask())

    @cached_property
    def inspiration(self):
        """CT surface at full inspiration."""
        return _kept_mesh(self._film.inspiration())

    @cached_property
    def expiration(self):
        """CT surface at full expiration, same faces, with the registration's error where the film has one."""
        return _kept_mesh(self._film.expiration())

    @cached_property
    def centerline_mm(self):
        """(n, 3), points of the lumen's centreline at inspiration."""
        return _kept(self._film.centerline_mm())

    @cached_property
    def targets_mm(self):
        """(n, 3), targets as planned at inspiration."""
        return _kept(self._film.targets_mm)

    @property
    def breathing_period_s(self):
        """Mean duration of a breath."""
        return self._film.breathing_period_s

    @property
    def held_out_frames(self):
        """Frames 7, 15, ..: to be rendered before their image is used (`ahead`)."""
        return self._film.held_out_frames

    @property
    def novel_frames(self):
        """Frames with a second camera, whose picture no method sees."""
        return self._film.novel_frames

    @cached_property
    def novel_poses(self):
        """(n, 4, 4), poses of the second cameras, in the order of `novel_frames`."""
        return _kept(self._film.novel_poses)

    @property
    @_of_truth
    def case(self):
        """Truth: the case that was filmed."""
        return self._film.case_id

    @cached_property
    @_of_truth
    def phases(self):
        """Truth: (frames,), breathing phase, 0 full inspiration, 1 full expiration."""
        return _kept(self._film.phases)

    @cached_property
    @_of_truth
    def true_poses(self):
        """Truth: (frames, 4, 4), the poses as they were. On the clinical track `poses` are what a sensor says of them."""
        return _kept(self._film.true_poses)

    @cached_property
    @_of_truth
    def true_novel_poses(self):
        """Truth: (n, 4, 4), the poses of the second cameras as they were."""
        return _kept(self._film.true_novel_poses)

    @cached_property
    @_of_truth
    def true_K(self):
        """Truth: (3, 3), the intrinsics as they were. On the clinical track `K` are those of the lens's data sheet."""
        return _kept(_matrix_of(self._film.true_intrinsics))

    @cached_property
    @_of_truth
    def true_fisheye(self):
        """Truth: `k1..k4` as they were; `None` for a pinhole."""
        return self._film.true_fisheye and _kept(np.array(self._film.true_fisheye))

    @cached_property
    @_of_truth
    def true_inspiration(self):
        """Truth: the surface at full inspiration."""
        return _kept_mesh(self._film.true_inspiration())

    @cached_property
    @_of_truth
    def true_expiration(self):
        """Truth: the surface at full expiration, same faces as `true_inspiration`."""
        return _kept_mesh(self._film.true_expiration())

    @cached_property
    @_of_truth
    def targets_by_frame_mm(self):
        """Truth: (frames, n, 3), where the targets are at every frame."""
        return _kept(self._film.targets_by_frame_mm)

    @cached_property
    @_of_truth
    def gains(self):
        """Truth: (frames,), exposure gain applied to the linear radiance."""
        return _kept(self._film.gains)

    @cached_property
    @_of_truth
    def targets_expiration_mm(self):
        """Truth: (n, 3), where the targets are at full expiration."""
        return _kept(self._film.targets_expiration_mm)

    @property
    @_of_truth
    def meshes(self):
        """Truth: the surface at each frame, as `Mesh`; of a film of the clinical track the last alone, `meshes[-1]`."""
        return _Meshes(self)

    @property
    @_of_truth
    def novel_images(self):
        """Truth: what the second cameras saw, in the order of `novel_frames`."""
        return Lazy(self, "novel_images", self.novel_frames)

    @property
    @_of_truth
    def novel_depths_mm(self):
        """Truth: their z-depths in mm."""
        return Lazy(self, "novel_depths_mm", self.novel_frames)


class _Meshes:
    """The surface at each frame, computed when it is used."""

    def __init__(self, film):
        self._film = film

    def __len__(self):
        return len(self._film)

    def __getitem__(self, index):
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        return Mesh(*self._film._film.true_mesh(self._film._frame(index)))

    def __iter__(self):
        return (self[index] for index in range(len(self)))


def load(sequence, truth=False):
    """Opens a film: a sequence folder, or the folder that participants of a blind comparison get.

    Only what a method may see, unless `truth=True`; the truth of a participant's folder is elsewhere. Raises `Error`,
    one sentence that names the file.
    """
    return Film(sequence, truth)
