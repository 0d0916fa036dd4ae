"""Photos on their side share the camera of the others: their features are turned for the search, their cameras back after it.

A point (x, y) of a photo of width w and height h is (h - y, x) once the photo is turned by a quarter.
"""

import sqlite3

import numpy as np
import pycolmap

# Against a quarter turn about the optical axis, as a quaternion (x, y, z, w).
TURN_BACK = [0, 0, -(0.5**0.5), 0.5**0.5]


def turned_names(sizes):
    """The photos that are turned: those of the rarer of two sizes."""
    return set(min(sizes, key=len)) if len(sizes) == 2 else set()


def turned_keypoints(keypoints, height):
    """Keypoints (x, y, and a matrix by rows) of a photo of this height, once it is turned."""
    x, y, a11, a12, a21, a22 = keypoints.T
    return np.stack([height - y, x, -a21, -a22, a11, a12], axis=1)


def share_camera(path, sizes):
    """Turns the features of photos on their side, and gives these the camera of the others; what was turned before stays."""
    names = turned_names(sizes)
    database = sqlite3.connect(path)
    if names and has_frames(database):
        with database:
            turn_photos(database, names)
    database.close()


def has_frames(database):
    """COLMAP 3.11 and older has none, and each size keeps its camera."""
    return database.execute("SELECT 1 FROM sqlite_master WHERE name = 'frame_data'").fetchone() is not None


def turn_photos(database, names):
    photos = database.execute(
        "SELECT name, image_id, camera_id, height FROM images JOIN cameras USING (camera_id)"
    ).fetchall()
    shared = next((camera for name, _, camera, _ in photos if name not in names), None)
    lying = [photo for photo in photos if photo[0] in names and photo[2] != shared]
    if shared is None:
        return
    (rig,) = database.execute("SELECT rig_id FROM rigs WHERE ref_sensor_id = ? AND ref_sensor_type = 0", [shared]).fetchone()
    for _, photo, _, height in lying:
        turn_photo(database, photo, height)
        database.execute("UPDATE images SET camera_id = ? WHERE image_id = ?", [shared, photo])
        of_photo = "data_id = ? AND sensor_type = 0"
        database.execute(
            f"UPDATE frames SET rig_id = ? WHERE frame_id IN (SELECT frame_id FROM frame_data WHERE {of_photo})", [rig, photo]
        )
        database.execute(f"UPDATE frame_data SET sensor_id = ? WHERE {of_photo}", [shared, photo])
        database.execute(
            "UPDATE pose_priors SET corr_sensor_id = ? WHERE corr_data_id = ? AND corr_sensor_type = 0", [shared, photo]
        )
    for camera in {camera for _, _, camera, _ in lying}:
        database.execute("DELETE FROM rigs WHERE ref_sensor_id = ? AND ref_sensor_type = 0", [camera])
        database.execute("DELETE FROM cameras WHERE camera_id = ?", [camera])


def turn_photo(database, photo, height):
    data, columns = database.execute("SELECT data, cols FROM keypoints WHERE image_id = ?", [photo]).fetchone()
    keypoints = np.frombuffer(data, np.float32).reshape(-1, columns)
    turned = turned_keypoints(keypoints, np.float32(height))
    database.execute("UPDATE keypoints SET data = ? WHERE image_id = ?", [turned.astype(np.float32).tobytes(), photo])


def turned_back(model, names, images):
    """The model of the photos as they lie in their files; those on their side have the same camera, on its side."""
    lying = {number for number, image in model.images.items() if image.name in names}
    if not lying:
        return model
    back, places = pycolmap.Reconstruction(), {}
    for number, image in model.images.items():
        if image.has_pose:
            add_photo(back, model, image, number in lying, places)
    for point in model.points3D.values():
        back.add_point3D(point.xyz, point.track, point.color)
    back.update_point_3d_errors()
    # They were taken from where the features of turned photos are not.
    back.extract_colors_for_all_images(images)
    return back


def add_photo(back, model, image, is_lying, places):
    camera = model.cameras[image.camera_id]
    camera_id = places.setdefault((image.camera_id, is_lying), len(places) + 1)
    if camera_id not in back.cameras:
        back.add_camera_with_trivial_rig(placed_camera(camera, camera_id, is_lying))
    pose, points = image.cam_from_world(), np.array([point.xy for point in image.points2D]).reshape(-1, 2)
    if is_lying:
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(TURN_BACK), [0, 0, 0]) * pose
        points = np.stack([points[:, 1], camera.width - points[:, 0]], axis=1)
    photo = pycolmap.Image(name=image.name, keypoints=points, camera_id=camera_id, image_id=image.image_id)
    back.add_image_with_trivial_frame(photo, pose)


def placed_camera(camera, camera_id, is_lying):
    """A camera of photos that are turned by a quarter, as it is of the photos as they lie."""
    focal_px, x, y, *distortion = camera.params
    size, middle = (camera.width, camera.height), (x, y)
    if is_lying:
        size, middle = size[::-1], (y, camera.width - x)
    return pycolmap.Camera(
        camera_id=camera_id,
        model=camera.model,
        width=size[0],
        height=size[1],
        params=[focal_px, *middle, *distortion],
        has_prior_focal_length=camera.has_prior_focal_length,
    )
