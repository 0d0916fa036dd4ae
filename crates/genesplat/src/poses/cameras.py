"""Cameras and points: how they are found, and what is done to them then."""

import os

import pycolmap


def map_photos(job, models, tell, start=""):
    """Finds cameras and points, or goes on with those of the model in the folder `start`."""
    options = mapping_options(job)
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
    pycolmap.bundle_adjustment(finer, options.get_global_bundle_adjustment())
    finer.update_point_3d_errors()
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
