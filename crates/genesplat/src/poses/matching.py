"""What the database of COLMAP holds: features are bounded, pairs of photos chosen, matched and counted.

Of two copies of SQLite in one process, each breaks the locks of the other. Where Python's reads, COLMAP's has nothing open.
"""

import os
import sqlite3
import tempfile
import urllib.parse

import numpy as np
import pycolmap

# COLMAP tries points at random; with one seed, two searches of the same photos find nearly always the same.
SEED = 0
# Features that tell which photos look alike.
TELLING = 200
# Each photo is matched with so many that look most alike, ...
ALIKE = 25
# ... with so many that were taken nearest, where all tell where, ...
NEAR = 10
# ... and with so many before and after it, where their order is that of a walk or of a film.
NEIGHBOURS = 10
# A photo without a camera is compared with so many that have one.
RETRIED = 300
# Before names that a list of pairs cannot have.
QUOTED = "\x01"


def bound_features(path, most):
    """Leaves each photo the `most` largest features: COLMAP stops at the first scale at which it has more."""
    database = sqlite3.connect(path)
    with database:
        for (photo,) in database.execute("SELECT image_id FROM keypoints WHERE rows > ?", [most]).fetchall():
            keypoints, descriptors = of_photo(database, "keypoints", photo), of_photo(database, "descriptors", photo)
            kept = np.sort(np.argsort(-scales_of(keypoints), kind="stable")[:most])
            keep(database, "keypoints", photo, keypoints[kept])
            keep(database, "descriptors", photo, descriptors[kept])
    database.close()


def of_photo(database, table, photo):
    data, columns = database.execute(f"SELECT data, cols FROM {table} WHERE image_id = ?", [photo]).fetchone()
    return np.frombuffer(data, np.float32 if table == "keypoints" else np.uint8).reshape(-1, columns)


def keep(database, table, photo, values):
    database.execute(
        f"UPDATE {table} SET rows = ?, data = ? WHERE image_id = ?", [len(values), values.tobytes(), photo]
    )


def scales_of(keypoints):
    """Of keypoints (x, y, and a matrix that says how large a feature is and how it is turned)."""
    if keypoints.shape[1] < 6:
        return keypoints[:, 2]
    return np.sqrt(np.abs(keypoints[:, 2] * keypoints[:, 5] - keypoints[:, 3] * keypoints[:, 4]))


class Photos:
    """The photos of a database, by name: of number i, `ids[i]` and `names[i]`."""

    def __init__(self, path):
        self.path = path
        with pycolmap.Database.open(path) as database:
            images = sorted(database.read_all_images(), key=lambda image: image.name)
        self.ids = [image.image_id for image in images]
        self.names = [image.name for image in images]
        self.number = {photo: number for number, photo in enumerate(self.ids)}

    def without(self, model):
        """The numbers of those that have no camera in a model."""
        return set(range(len(self.ids))) - {self.number[photo] for photo in model.reg_image_ids()}

    def matched_pairs(self):
        """Those that were compared, alike or not."""
        database = sqlite3.connect(self.path)
        ids = [pycolmap.pair_id_to_image_pair(pair) for (pair,) in database.execute("SELECT pair_id FROM matches")]
        database.close()
        numbers = ((self.number[a], self.number[b]) for a, b in ids)
        return {(min(pair), max(pair)) for pair in numbers}

    def likeness(self):
        with pycolmap.Database.open(self.path) as database:
            return likeness(np.stack([self.telling_features(database, photo) for photo in self.ids]))

    def telling_features(self, database, photo):
        scales = scales_of(database.read_keypoints(photo))
        return strongest(scales, database.read_descriptors(photo).data, TELLING)

    def degrees(self):
        """Latitude and longitude, NaN where a photo does not tell."""
        degrees = np.full((len(self.ids), 2), np.nan)
        with pycolmap.Database.open(self.path) as database:
            priors = database.read_all_pose_priors()
        for prior in priors:
            number = self.number.get(prior.corr_data_id.id)
            if number is not None and prior.coordinate_system == pycolmap.PosePriorCoordinateSystem.WGS84:
                degrees[number] = np.ravel(prior.position)[:2]
        return degrees


def chosen_pairs(photos, pairing):
    """The pairs to match, and what chose them: nothing where they are all."""
    if pairing == "all":
        return all_pairs(len(photos.ids)), []
    alike = photos.likeness()
    pairs, chosen_by = nearest(alike, ALIKE), ["looks"]
    places = closeness_of_places(photos.degrees())
    if places is not None:
        pairs |= nearest(places, NEAR)
        chosen_by.append("place")
    if pairing == "sequence" or is_walk(alike, ALIKE):
        pairs |= pairs_in_order(len(photos.ids), NEIGHBOURS)
        chosen_by.append("order")
    return pairs, chosen_by


def pairs_of_left_out(photos, left_out):
    """Each photo that is left out with those that are not; where these are many, with those that look most alike."""
    has_camera = sorted(set(range(len(photos.ids))) - left_out)
    if len(has_camera) <= RETRIED:
        return {(min(i, j), max(i, j)) for i in left_out for j in has_camera}
    return pairs_with(photos.likeness(), left_out, has_camera, RETRIED)


def match_pairs(path, pairs, threads):
    """Matches those pairs of photos that are not matched yet. COLMAP reads a list of names with a blank between them."""
    quote_names(path)
    names = Photos(path).names
    options = pycolmap.FeatureMatchingOptions()
    options.num_threads = threads
    geometry = pycolmap.TwoViewGeometryOptions()
    geometry.ransac.random_seed = SEED
    pairing = pycolmap.ImportedPairingOptions()
    file, pairing.match_list_path = tempfile.mkstemp(
        ".tmp", f".genesplat-{os.getpid()}-", os.path.dirname(path)
    )
    try:
        with open(file, "w", encoding="utf-8", newline="\n") as list_of_pairs:
            list_of_pairs.writelines(f"{names[i]} {names[j]}\n" for i, j in sorted(pairs))
        pycolmap.match_image_pairs(
            path,
            matching_options=options,
            pairing_options=pairing,
            verification_options=geometry,
            device=pycolmap.Device.cpu,
        )
    finally:
        os.remove(pairing.match_list_path)
        unquote_names(path)


def quote_names(path):
    with pycolmap.Database.open(path) as database:
        for image in database.read_all_images():
            if image.name.split() != [image.name] or image.name[0] in "#" + QUOTED:
                image.name = QUOTED + urllib.parse.quote(image.name)
                database.update_image(image)


def unquote_names(path):
    """Also what a search that was ended has left."""
    with pycolmap.Database.open(path) as database:
        for image in database.read_all_images():
            if image.name.startswith(QUOTED):
                image.name = urllib.parse.unquote(image.name[1:])
                database.update_image(image)
