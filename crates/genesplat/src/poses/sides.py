"""Sides that look alike: a group of cameras that false matches hold in a wrong place is found, and cameras without these."""

import sqlite3

import numpy as np
import pycolmap

# A model that joins two groups is doubted where so many of the matched features that these share contradict it. (Bonsai, whose
# table has sides that look alike: 83 %; right models of it and of four others: at most 23 %, lab/performance.md.)
DOUBTED = 0.5
# A match contradicts a model where it is farther from its epipolar lines, px.
AGREES_PX = 4.0
# Each group has at least such a part of the photos.
PART = 0.1


def weakest_cut(shared):
    """Two groups that share the fewest points, for how many they have: the best cut of the spectral order (Shi and Malik, 2000)."""
    degrees = np.maximum(shared.sum(axis=1), 1e-9)
    laplacian = np.eye(len(shared)) - shared / np.sqrt(np.outer(degrees, degrees))
    order = np.argsort(np.linalg.eigh(laplacian)[1][:, 1] / np.sqrt(degrees), kind="stable")
    least = max(1, int(PART * len(order)))
    cuts = range(least, len(order) - least + 1)

    def conductance(k):
        one, other = order[:k], order[k:]
        return shared[np.ix_(one, other)].sum() / min(degrees[one].sum(), degrees[other].sum())

    k = min(cuts, key=conductance)
    return order[:k], order[k:]


def shared_points(model, number):
    """How many points each two photos see. `number` has a place for the identifier of each photo."""
    shared = np.zeros((len(number), len(number)))
    for point in model.points3D.values():
        seen = sorted({number[element.image_id] for element in point.track.elements})
        shared[np.ix_(seen, seen)] += 1
    np.fill_diagonal(shared, 0)
    return shared


def agreement(model, path, number):
    """How many features of each two photos were matched, and how many of these agree with the model."""
    matched, agree = np.zeros((2, len(number), len(number)))
    database = sqlite3.connect(path)
    rays = {}
    for pair, data in database.execute("SELECT pair_id, data FROM two_view_geometries WHERE rows > 0"):
        a, b = pycolmap.pair_id_to_image_pair(pair)
        if a in number and b in number:
            at = number[a], number[b]
            matches = np.frombuffer(data, np.uint32).reshape(-1, 2)
            matched[at] = len(matches)
            agree[at] = agreeing(model, a, b, matches, rays)
    database.close()
    return matched + matched.T, agree + agree.T


def agreeing(model, a, b, matches, rays):
    one, other = model.images[a], model.images[b]
    for image in one, other:
        if image.image_id not in rays:
            camera, pixels = model.cameras[image.camera_id], [point.xy for point in image.points2D]
            places = camera.cam_from_img(np.array(pixels, np.float64).reshape(-1, 2))
            rays[image.image_id] = np.concatenate([places, np.ones((len(places), 1))], axis=1)
    pose = other.cam_from_world() * one.cam_from_world().inverse()
    x, y, z = pose.translation
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ pose.rotation.matrix()
    from_one, from_other = rays[a][matches[:, 0]], rays[b][matches[:, 1]]
    lines, back = from_one @ essential.T, from_other @ essential
    norm = np.sqrt((lines[:, :2] ** 2).sum(1) + (back[:, :2] ** 2).sum(1))
    off = np.abs((from_other * lines).sum(1)) / np.maximum(norm, 1e-12)
    focal_px = model.cameras[one.camera_id].mean_focal_length()
    return int((focal_px * off < AGREES_PX).sum())


def doubted(model, path):
    """The photos of the smaller group, and the pairs that hold it where most matches contradict it; None where they do not."""
    ids = sorted(model.reg_image_ids())
    number = {photo: place for place, photo in enumerate(ids)}
    if len(ids) < 2 / PART:
        return None
    one, other = weakest_cut(shared_points(model, number))
    matched, agree = agreement(model, path, number)
    across = np.ix_(one, other)
    if agree[across].sum() >= (1 - DOUBTED) * matched[across].sum():
        return None
    holding = [(ids[i], ids[j]) for i in one for j in other if matched[i, j] > 0 and 2 * agree[i, j] >= matched[i, j]]
    return len(min(one, other, key=len)), holding


def all_agreeing(model, path):
    """How many matched features agree with the model."""
    number = {photo: place for place, photo in enumerate(sorted(model.reg_image_ids()))}
    return agreement(model, path, number)[1].sum() / 2


def leave_out(path, pairs):
    """Takes these pairs from those that cameras are found by; returns what brings them back."""
    database = sqlite3.connect(path)
    with database:
        numbers = [[pycolmap.image_pair_to_pair_id(*pair)] for pair in pairs]
        rows = [
            database.execute("SELECT rows, data, config, pair_id FROM two_view_geometries WHERE pair_id = ?", pair).fetchone()
            for pair in numbers
        ]
        database.executemany("UPDATE two_view_geometries SET rows = 0, data = NULL, config = 0 WHERE pair_id = ?", numbers)
    database.close()
    return rows


def bring_back(path, rows):
    database = sqlite3.connect(path)
    with database:
        database.executemany("UPDATE two_view_geometries SET rows = ?, data = ?, config = ? WHERE pair_id = ?", rows)
    database.close()
