"""Stands for pycolmap: it finds the cameras of the model at GENESPLAT_TEST_MODEL, whatever it is asked for."""

import os
import shutil

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

    def cam_from_world(self):
        return self

    rotation = property(lambda self: self)

    def matrix(self):
        return [None, Row((0, 0, 0))]


class Reconstruction(Anything):
    images = {1: Image()}

    def compute_mean_reprojection_error(self):
        return 0.5


def incremental_mapping(database, images, models, **_):
    shutil.copytree(os.environ["GENESPLAT_TEST_MODEL"], os.path.join(models, "0"))


def __getattr__(name):
    if name.startswith("__"):
        raise AttributeError(name)
    return Anything()
