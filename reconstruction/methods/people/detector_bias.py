"""Biases of detectors: what all cameras see wrongly together, as films with a reference showed it."""

import tomllib
from importlib.resources import files

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.methods.people.skeletons import SKELETONS, Skeleton

BIASES = tomllib.loads(files(__package__).joinpath("detector_bias.toml").read_text("utf-8"))
"""By the name of a skeleton: the `source`, and the bias of each measured joint, as a fraction of the size."""


def detector_bias(skeleton: Skeleton) -> tuple[Array | None, str]:
    """Return the bias (joints,) of what finds a skeleton, and its source; None and "" if it was not measured.

    It is a standard deviation by axis, relative to an individual's size: the diagonal of the box around its
    joints. A joint without a reference has the largest of the others.
    """
    for name, table in BIASES.items():
        if SKELETONS[name].joints == skeleton.joints:
            largest = max(table["joints"].values())
            return np.array([table["joints"].get(joint, largest) for joint in skeleton.joints]), table[
                "source"
            ]
    return None, ""
