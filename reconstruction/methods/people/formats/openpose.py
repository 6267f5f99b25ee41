"""OpenPose's JSON, a file for each frame; RTMLib's and Pose2Sim's, too.

According to https://cmu-perceptual-computing-lab.github.io/openpose (output), a file's name has the number of
its frame, and `people` in it have `pose_keypoints_2d`, x, y and confidence of each joint.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.session.files.untrusted_files import read_text
from reconstruction.common.geometry import Array
from reconstruction.methods.people.joint_formats import JointReader, Labels, labels_of, number_in


def read(files: Sequence[Path]) -> Labels | None:
    """Return the labels in files of one frame each; None if the first has no `people`."""
    frames = dict[int, list[Array]]()
    for path in files:
        content = json.loads(read_text(path))
        if not frames and not (isinstance(content, dict) and "people" in content):
            return None
        people = [person["pose_keypoints_2d"] for person in content["people"]]
        frames[number_in(path.name)] = [np.reshape(person, (-1, 3)) for person in people if person]
    return labels_of(frames)


READER = JointReader(program="OpenPose", suffixes=(".json",), read=read)
