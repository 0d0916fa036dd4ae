"""Cameras and points: how they are found, and what is done to them then."""

import os

import pycolmap

# Of so many photos, all are compared, and cameras are found within minutes at COLMAP's own pace.
FEW = 150
# Of more, all cameras are corrected together each time that there are so many times as many: COLMAP does it at 1.1.
CORRECTED_AT = 1.4
# ... at most so often (COLMAP: 5), ...
CORRECTIONS = 2
# ... and each time until the error falls by less than such a part (COLMAP: 0, which is to say never).
SETTLED = 1e-6


def map_photos(job, models, tell, start="", keeps_focal=False):
    """Finds cameras and points, or goes on with those of the model in the folder `start`."""
    options = mapping_options(job)
    options.ba_refine_focal_length = not keeps_focal
    if job["photos"] > FEW:
        hasten(options)
    os.makedirs(models, exist_ok=True)
    pycolmap.incremental_mapping(
        job["database"], job["images"], models, options=options, input_path=start, next_image_callback=tell
    )


def mapping_options(job):
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = job["threads"]
    options.random_seed = SEED
    options.max_extra_param = job["max_distortion"]
    return options


def hasten(options):
    """Bundle adjustments of all cameras are most of the time where photos are many, and the last ones count."""
    # The names of two versions.
    for ratio in ("ba_global_frames_ratio", "ba_global_images_ratio", "ba_global_points_ratio"):
        if hasattr(options, ratio):
            setattr(options, ratio, CORRECTED_AT)
    options.ba_global_max_refinements = CORRECTIONS
    options.ba_global_function_tolerance = options.ba_local_function_tolerance = SETTLED


def calibrate(job):
    """Finds the focal length of one camera from pairs of photos alone, where there are many and nothing else tells it.

    A search that begins with a wrong one may bend what is found first beyond repair; one that does not keep it may, too.
    Returns whether it is known so.
    """
    # Versions before 4 cannot.
    if job["is_round"] or job["photos"] <= FEW or not hasattr(pycolmap, "calibrate_view_graph"):
        return False
    # Of a search that was ended: the database says no more where a focal length is from.
    mark = job["database"] + ".calibrated"
    if os.path.exists(mark):
        return job["single_camera"]
    with pycolmap.Database.open(job["database"]) as database:
        if any(camera.has_prior_focal_length for camera in database.read_all_cameras()):
            return False
    options = pycolmap.ViewGraphCalibrationOptions()
    options.random_seed = SEED
    if not pycolmap.calibrate_view_graph(job["database"], options):
        return False
    open(mark, "w").close()
    return job["single_camera"]


def settle(model, options):
    """Corrects all cameras and points together until nothing gets better."""
    pycolmap.bundle_adjustment(model, options.get_global_bundle_adjustment())
    model.update_point_3d_errors()


def read_models(models):
    """Each model in a folder, by its folder's name."""
    return {name: pycolmap.Reconstruction(os.path.join(models, name)) for name in sorted(os.listdir(models))}


def largest_of(models):
    """The name of the model with the most photos; of equal ones, the first."""
    return max(models, key=lambda name: models[name].num_reg_images())


def with_lens(model, folder, options):
    """The model with a second coefficient of distortion, where that explains the points better.

    Lenses of phones need it. What stands on a turntable far away does not tell it, and while cameras are still being found
    it would be made up, and the focal length with it.
    """
    finer = pycolmap.Reconstruction(folder)
    for camera in finer.cameras.values():
        focal_px, x, y, distortion = camera.params
        camera.model = pycolmap.CameraModelId.RADIAL
        camera.params = [focal_px, x, y, distortion, 0]
    settle(finer, options)
    if finer.compute_mean_reprojection_error() > 0.99 * model.compute_mean_reprojection_error():
        return model
    return finer


def turn_upright(model):
    """Turns the world so that -y is up, on average of the cameras, as viewers have it."""
    ups = [-image.cam_from_world().rotation.matrix()[1] for image in model.images.values() if image.has_pose]
    x, y, z = (float(part) for part in sum(ups) / max(len(ups), 1))
    length = (x * x + y * y + z * z) ** 0.5
    # Photos that look down have no common up.
    if length < 0.5:
        return
    turn = [z, 0, -x, length - y] if length - y > 1e-6 else [1, 0, 0, 0]
    size = sum(part * part for part in turn) ** 0.5
    rotation = pycolmap.Rotation3d([part / size for part in turn])
    model.transform(pycolmap.Sim3d(1, rotation, [0, 0, 0]))
