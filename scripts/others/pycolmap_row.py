"""The points that COLMAP triangulates in a film with known poses, as a prediction.

    python pycolmap_row.py PARTICIPANT COLMAP PREDICTION

COLMAP: `respire-bench export PARTICIPANT --format colmap`. COLMAP's part are the points; ours is to draw them: picture
and depth of a view are interpolated linearly between the points that COLMAP saw in the frame, in the image plane, and
beyond their hull are those of the nearest one. So every pixel has a value, and none is better than its points.
"""

import argparse
import json
import pathlib
import shutil
import tempfile
import time

import numpy as np
import pycolmap
from PIL import Image
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

METHOD = "colmap-points"
# COLMAP's own is 0.0067, meant for pictures of megapixels. In 128x128 pixels of a smooth wall it finds 22 features a
# frame, and not one point; no other setting is changed.
PEAK_THRESHOLD = 0.001
# A triangle needs three; with fewer, those of the frames nearest in time are drawn too.
LEAST_POINTS = 3


def triangulate(folder, work):
    """The model of COLMAP: the film's cameras, and points with tracks."""
    pycolmap.set_random_seed(0)
    known = pycolmap.Reconstruction(folder / "sparse/0")
    (camera,) = known.cameras.values()
    poses = {image.name: image.cam_from_world() for image in known.images.values()}
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = camera.model.name
    reader.camera_params = ",".join(str(float(value)) for value in camera.params)
    if (folder / "masks").exists():
        reader.mask_path = folder / "masks"
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.sift.peak_threshold = PEAK_THRESHOLD
    # On one thread, and with RANSAC's own seed, a film has the same points every time; otherwise the depth of a view
    # with few of them changes by half.
    extraction.num_threads = 1
    database = work / "database.db"
    on_cpu = {"device": pycolmap.Device.cpu}
    pycolmap.extract_features(
        database,
        folder / "images",
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
        **on_cpu,
    )
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = 0
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = 1
    pycolmap.match_exhaustive(database, matching_options=matching, verification_options=verification, **on_cpu)
    # The database numbers the images itself, so the model is made from it and only the poses are ours.
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as opened:
        for of_database in opened.read_all_cameras():
            model.add_camera_with_trivial_rig(of_database)
        for image in opened.read_all_images():
            model.add_image_with_trivial_frame(image, poses[image.name])
    return pycolmap.triangulate_points(model, database, folder / "images", work / "sparse")


def points_of_frames(images, names):
    """For every frame the numbers of its points; with too few, also those of the frames nearest in time."""
    seen = [{point.point3D_id for point in images[name].points2D if point.has_point3D()} for name in names]
    found = []
    for frame in range(len(names)):
        numbers = set()
        for other in sorted(range(len(names)), key=lambda other: (abs(other - frame), other)):
            numbers |= seen[other]
            if len(numbers) >= LEAST_POINTS:
                break
        found.append(sorted(numbers))
    return found


def draw(camera, cam_from_world, places, colors):
    """Picture (height, width, 3; 0..255) and z-depth in mm of a view, between points at `places` (mm) with `colors`."""
    in_camera = places @ cam_from_world[:, :3].T + cam_from_world[:, 3]
    in_front = in_camera[:, 2] > 0.1  # mm
    in_camera, colors = in_camera[in_front], colors[in_front]
    if len(in_camera) == 0:
        return np.zeros((camera.height, camera.width, 3)), np.zeros((camera.height, camera.width))
    at = camera.img_from_cam(in_camera)
    # Two points in one place have no triangle.
    at, kept = np.unique(at.round(6), axis=0, return_index=True)
    values = np.column_stack([colors, in_camera[:, 2]])[kept]
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    pixels = NearestNDInterpolator(at, values)(x, y)
    if len(at) >= 3 and np.linalg.matrix_rank(at - at[0]) == 2:
        inside = LinearNDInterpolator(at, values)(x, y)
        pixels = np.where(np.isnan(inside), pixels, inside)
    return pixels[..., :3], pixels[..., 3]


def second_cameras(participant):
    """Names and camera-from-world (3, 4) of the second cameras: nerfstudio's axes are turned to COLMAP's."""
    path = participant / "transforms_novel.json"
    for frame in json.loads(path.read_text())["frames"] if path.exists() else ():
        world_from_camera = np.array(frame["transform_matrix"]) @ np.diag([1, -1, -1, 1])
        yield pathlib.Path(frame["file_path"]).stem, np.linalg.inv(world_from_camera)[:3]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("participant", type=pathlib.Path)
    parser.add_argument("colmap", type=pathlib.Path)
    parser.add_argument("prediction", type=pathlib.Path)
    arguments = parser.parse_args()

    wall, cpu = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as work:
        model = triangulate(arguments.colmap, pathlib.Path(work))
    print(f"{model.num_points3D()} points, {model.compute_mean_track_length():.1f} views each")
    if model.num_points3D() == 0:
        raise SystemExit("pycolmap: COLMAP triangulated no point, so there is nothing to draw")
    (camera,) = model.cameras.values()
    images = {image.name: image for image in model.images.values()}
    names = sorted(images)
    of_frames = dict(zip((pathlib.Path(name).stem for name in names), points_of_frames(images, names), strict=True))

    def view(frame, cam_from_world):
        points = [model.points3D[number] for number in of_frames[frame]]
        return draw(camera, cam_from_world, np.array([p.xyz for p in points]), np.array([p.color for p in points]))

    fitted = {pathlib.Path(name).stem: images[name].cam_from_world().matrix() for name in names}
    views = [("color", "depth", frame, *view(frame, pose)) for frame, pose in fitted.items()]
    views += [
        ("novel", "novel_depth", frame, *view(frame, pose)) for frame, pose in second_cameras(arguments.participant)
    ]
    seconds = {"time_total_s": time.perf_counter() - wall, "time_cpu_s": time.process_time() - cpu}

    # All of the prediction or nothing.
    part = arguments.prediction.with_name(f".unfinished-{arguments.prediction.name}")
    shutil.rmtree(part, ignore_errors=True)
    for pictures, depths, frame, color, depth in views:
        (part / pictures).mkdir(parents=True, exist_ok=True)
        (part / depths).mkdir(exist_ok=True)
        Image.fromarray(np.rint(color).astype(np.uint8)).save(part / pictures / f"{frame}.png")
        np.save(part / depths / f"{frame}.npy", depth.astype(np.float32))
    (part / "timing.json").write_text(json.dumps(seconds))
    (part / "prediction.json").write_text(json.dumps({"method": METHOD}))
    part.rename(arguments.prediction)


if __name__ == "__main__":
    main()
