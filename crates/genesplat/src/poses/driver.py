"""Runs one stage of structure from motion with pycolmap. The only argument is a JSON object that says which.

Standard output gets a JSON object a line: {"done": 3, "total": 50} while a stage is under way. It ends when standard input
does, since then whoever has started it is gone.
"""

import json
import os
import sys
import threading
import time

import pycolmap

job = json.loads(sys.argv[1])

# COLMAP tries points at random. With one seed, two searches differ only by the order in which threads get done with photos.
SEED = 0


def say(**words):
    print(json.dumps(words), flush=True)


def end_with_parent():
    sys.stdin.buffer.read()
    os._exit(1)


def tell_progress(count, total):
    """Tells, twice a second, what the database counts by now.

    COLMAP's own copy of SQLite reads it: of two copies in one process, each breaks the locks of the other, and COLMAP aborts.
    """
    database = pycolmap.Database.open(job["database"])

    def tell():
        while True:
            time.sleep(0.5)
            try:
                say(done=min(getattr(database, count)(), total), total=total)
            except RuntimeError:
                pass

    in_background(tell)


def in_background(function):
    threading.Thread(target=function, daemon=True).start()


def extract_features():
    tell_progress("num_images", job["photos"])
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = job["threads"]
    options.max_image_size = job["max_side"]
    options.sift.max_num_features = job["max_features"]
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = job["camera_model"]
    if job["masks"]:
        reader.mask_path = job["masks"]
    pycolmap.extract_features(
        job["database"],
        job["images"],
        camera_mode=pycolmap.CameraMode.SINGLE if job["single_camera"] else pycolmap.CameraMode.AUTO,
        reader_options=reader,
        extraction_options=options,
        device=pycolmap.Device.cpu,
    )


def match_features():
    tell_progress("num_verified_image_pairs", job["pairs"])
    options = pycolmap.FeatureMatchingOptions()
    options.num_threads = job["threads"]
    geometry = pycolmap.TwoViewGeometryOptions()
    geometry.ransac.random_seed = SEED
    how = {"matching_options": options, "verification_options": geometry, "device": pycolmap.Device.cpu}
    if job["neighbours"] is None:
        pycolmap.match_exhaustive(job["database"], **how)
        return
    pairing = pycolmap.SequentialPairingOptions()
    pairing.overlap = job["neighbours"]
    pairing.quadratic_overlap = True
    pairing.loop_detection = False
    pycolmap.match_sequential(job["database"], pairing_options=pairing, **how)


def find_cameras():
    # The first pair counts for two.
    registered = [1]

    def tell():
        registered[0] = min(registered[0] + 1, job["photos"])
        say(done=registered[0], total=job["photos"])

    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = job["threads"]
    options.random_seed = SEED
    options.max_extra_param = job["max_distortion"]
    pycolmap.incremental_mapping(
        job["database"], job["images"], job["models"], options=options, next_image_callback=tell
    )
    folders = {name: os.path.join(job["models"], name) for name in os.listdir(job["models"])}
    models = {name: pycolmap.Reconstruction(folder) for name, folder in folders.items()}
    if job["single_camera"] and models:
        largest = max(models, key=lambda name: models[name].num_reg_images())
        models[largest] = with_lens(models[largest], folders[largest], options)
    for name, model in models.items():
        turn_upright(model)
        model.write(folders[name])
    say(errors_px={name: model.compute_mean_reprojection_error() for name, model in models.items()})


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


in_background(end_with_parent)
{"features": extract_features, "matches": match_features, "cameras": find_cameras}[job["stage"]]()
# Threads that read would keep the interpreter from ending.
sys.stdout.flush()
os._exit(0)
