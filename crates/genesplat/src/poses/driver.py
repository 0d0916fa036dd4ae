"""Runs one stage of structure from motion with pycolmap. The only argument is a JSON object that says which.

Standard output gets a JSON object a line: {"what": "matches", "done": 3, "total": 50} while a stage is under way. It ends when
standard input does, since then whoever has started it is gone. Before this part come those with `pairs`, `matching`,
`cameras`, `sides` and `turned`.
"""

import contextlib
import json
import os
import shutil
import sys
import threading
import time

import pycolmap

job = json.loads(sys.argv[1])
# A model that is to take the place of another has at least such a part of its photos.
MOSTLY = 0.9


def say(**words):
    print(json.dumps(words), flush=True)


def end_with_parent():
    # Without Python's buffer, whose lock would hide why the script ends.
    while os.read(0, 4096):
        pass
    os._exit(1)


@contextlib.contextmanager
def progress(what, count, total):
    """Tells, twice a second, what `count` says of the database by now.

    COLMAP's own copy of SQLite reads it: of two copies in one process, each breaks the locks of the other, and COLMAP aborts.
    """
    ended = threading.Event()

    def tell():
        with pycolmap.Database.open(job["database"]) as database:
            while not ended.wait(0.5):
                try:
                    say(what=what, done=min(count(database), total), total=total)
                except RuntimeError:
                    pass

    say(what=what, done=0, total=total)
    teller = in_background(tell)
    try:
        yield
    finally:
        ended.set()
        teller.join()


def in_background(function):
    thread = threading.Thread(target=function, daemon=True)
    thread.start()
    return thread


def extract_features():
    with progress("features", photos_with_features, job["photos"]):
        for names in job["sizes"] or [[]]:
            extract_features_of(names)
    share_camera(job["database"], job["sizes"])


def photos_with_features(database):
    return sum(database.exists_keypoints(image.image_id) for image in database.read_all_images())


def compared_pairs(database):
    return database.num_matched_image_pairs()


def extract_features_of(names):
    """Of the photos with these names; where there are none, of all. Photos of one camera have one size.

    They get their numbers in the order of their names before, and not in that in which threads are done with them: the search
    hangs on it.
    """
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = job["threads"]
    options.max_image_size = job["max_side"]
    options.sift.max_num_features = job["max_features"]
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = job["camera_model"]
    if job["masks"]:
        reader.mask_path = job["masks"]
    if job["single_camera"]:
        reader.existing_camera_id = camera_of(job["database"], names)
    mode = pycolmap.CameraMode.SINGLE if job["single_camera"] else pycolmap.CameraMode.AUTO
    # COLMAP wants the file to be there.
    pycolmap.Database.open(job["database"]).close()
    pycolmap.import_images(job["database"], job["images"], mode, image_names=names, options=reader)
    if job["single_camera"]:
        reader.existing_camera_id = camera_of(job["database"], names)
    pycolmap.extract_features(
        job["database"],
        job["images"],
        image_names=names,
        camera_mode=mode,
        reader_options=reader,
        extraction_options=options,
        device=pycolmap.Device.cpu,
    )


def camera_of(path, names):
    """The camera of these photos, or of all, where a search that was stopped has got to some of them; -1 where it has not."""
    with pycolmap.Database.open(path) as database:
        images = database.read_all_images()
    return next((image.camera_id for image in images if not names or image.name in names), -1)


def match_features():
    unquote_names(job["database"])
    bound_features(job["database"], job["max_features"])
    pairs, chosen_by = chosen_pairs(Photos(job["database"]), job["pairing"])
    with progress("matches", compared_pairs, len(pairs)):
        match_pairs(job["database"], pairs, job["threads"])
    say(chosen_by=chosen_by)


def find_cameras():
    # The first pair counts for two.
    registered = [1]

    def tell():
        registered[0] = min(registered[0] + 1, job["photos"])
        say(what="cameras", done=registered[0], total=job["photos"])

    unquote_names(job["database"])
    keeps_focal = calibrate(job)
    map_photos(job, job["models"], tell, keeps_focal=keeps_focal)
    models = read_models(job["models"])
    if models:
        largest = largest_of(models)
        registered[0] = models[largest].num_reg_images()
        retry_left_out(models[largest], os.path.join(job["models"], largest), tell)
        mend_sides(os.path.join(job["models"], largest), keeps_focal)
    finish_models()


def retry_left_out(model, folder, tell):
    """Compares the photos that have no camera with those that do, and goes on from there."""
    photos = Photos(job["database"])
    left_out, matched = photos.without(model), photos.matched_pairs()
    pairs = pairs_of_left_out(photos, left_out) - matched
    if not pairs:
        return
    say(retried=len(left_out), pairs=len(pairs))
    with progress("matches", compared_pairs, len(matched) + len(pairs)):
        match_pairs(job["database"], pairs, job["threads"])
    map_photos(job, folder, tell, start=folder)


def mend_sides(folder, keeps_focal):
    """Where most matches contradict where a group of photos was found, finds cameras without those that agree with it."""
    old = pycolmap.Reconstruction(folder)
    doubt = doubted(old, job["database"])
    if doubt is None:
        return
    photos, holding = doubt
    say(doubted=photos)
    rows, anew = leave_out(job["database"], holding), job["models"] + "-anew"
    shutil.rmtree(anew, ignore_errors=True)
    map_photos(job, anew, lambda: None, keeps_focal=keeps_focal)
    bring_back(job["database"], rows)
    models = read_models(anew)
    if models and is_better(models[largest_of(models)], old):
        shutil.rmtree(job["models"])
        os.rename(anew, job["models"])
        return
    shutil.rmtree(anew, ignore_errors=True)
    say(unsure=photos)


def is_better(new, old):
    """Whether more matches agree with it, of all that there are, and few photos are lost."""
    agreed = [all_agreeing(model, job["database"]) for model in (old, new)]
    return new.num_reg_images() >= MOSTLY * old.num_reg_images() and agreed[0] < agreed[1] and not doubted(new, job["database"])


def finish_models():
    models, options = read_models(job["models"]), mapping_options(job)
    if models and job["photos"] > FEW:
        largest = largest_of(models)
        settle(models[largest], options)
        # A lens is found from here.
        models[largest].write(os.path.join(job["models"], largest))
    if job["single_camera"] and not job["is_round"] and models:
        largest = largest_of(models)
        models[largest] = with_lens(models[largest], os.path.join(job["models"], largest), options)
    for name, model in models.items():
        model = models[name] = turned_back(model, turned_names(job["sizes"]), job["images"])
        turn_upright(model)
        model.write(os.path.join(job["models"], name))
    say(errors_px={name: model.compute_mean_reprojection_error() for name, model in models.items()})
    if models:
        say(compared=what_was_compared(models[largest_of(models)]))


def what_was_compared(model):
    """How many pairs, of how many, and whether all of a photo without a camera and one with."""
    photos = Photos(job["database"])
    matched, left_out = photos.matched_pairs(), photos.without(model)
    count = len(photos.ids)
    across = sum((i in left_out) != (j in left_out) for i, j in matched)
    return {
        "pairs": len(matched),
        "of": count * (count - 1) // 2,
        "left_out_with_all": across == len(left_out) * (count - len(left_out)),
    }


in_background(end_with_parent)
{"features": extract_features, "matches": match_features, "cameras": find_cameras}[job["stage"]]()
# For who looks into the log; the time on a clock depends on what else the machine does.
say(stage=job["stage"], processor_seconds=round(time.process_time(), 1))
# Threads that read would keep the interpreter from ending.
sys.stdout.flush()
os._exit(0)
