"""Stands for pycolmap: it finds the cameras of the model at GENESPLAT_TEST_MODEL, whatever it is asked for."""

import os
import shutil
import sqlite3

__version__ = "pretended"


class Anything(int):
    """Has what is asked of it, does nothing, and counts as 0."""

    images = {}
    cameras = {}

    def __new__(cls, *_, **__):
        return super().__new__(cls)

    def __getattr__(self, name):
        return Anything()

    def __call__(self, *_, **__):
        return Anything()


class Row(tuple):
    def __neg__(self):
        return self

    def __radd__(self, _):
        return self

    def __truediv__(self, _):
        return self


class Image:
    has_pose = True
    name = "a photo"

    def cam_from_world(self):
        return self

    rotation = property(lambda self: self)

    def matrix(self):
        return [None, Row((0, 0, 0))]


class Database(Anything):
    """Without photos."""

    @staticmethod
    def open(_):
        return Database()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def read_all_images(self):
        return []


class Reconstruction(Anything):
    images = {1: Image()}

    def reg_image_ids(self):
        return []

    def compute_mean_reprojection_error(self):
        return 0.5


def extract_features(database, *_, **__):
    with sqlite3.connect(database) as made:
        made.execute("CREATE TABLE keypoints (image_id, rows)")
        made.execute("CREATE TABLE matches (pair_id)")


def incremental_mapping(database, images, models, **_):
    shutil.copytree(os.environ["GENESPLAT_TEST_MODEL"], os.path.join(models, "0"))


def __getattr__(name):
    if name.startswith("__"):
        raise AttributeError(name)
    return Anything()
