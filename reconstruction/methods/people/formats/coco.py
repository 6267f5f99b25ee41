"""COCO's JSON of keypoints, results and annotations, as MMPose and AlphaPose write them.

According to https://cocodataset.org (format-results, format-data), AlphaPose's doc/output.md, and MMPose's
base_mmpose_inferencer.py and topdown_demo_with_mmdet.py: a list of results with `image_id`, annotations with
`images`, a list of frames with `frame_id` and `instances`, or a file of instances for each image.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.session.files.untrusted_files import read_text
from reconstruction.common.geometry import Array
from reconstruction.methods.people.joint_formats import JointReader, Labels, labels_of, number_in
from reconstruction.methods.people.skeletons import Skeleton


def read(files: Sequence[Path]) -> Labels | None:
    """Return the labels in a file of all frames, or in files of one frame each; None if they have none."""
    frames, skeleton = dict[int, list[Array]](), None
    for path in files:
        content = json.loads(read_text(path))
        if isinstance(content, dict) and not {"annotations", "instance_info"} & {*content}:
            return None
        if isinstance(content, dict) and (kinds := content.get("categories")):
            bones = tuple((a - 1, b - 1) for a, b in kinds[0].get("skeleton", ()))
            skeleton = Skeleton(tuple(map(str, kinds[0]["keypoints"])), bones)
        for image, people in _images(path, content):
            own = frames.setdefault(number_in(str(image)), [])
            own += map(_joints, people)
    return labels_of(frames, skeleton)


def _images(path: Path, content: Any) -> Iterator[tuple[Any, list[Any]]]:
    """Yield the number or the name of each image, and individuals in it."""
    if isinstance(content, dict) and "annotations" in content:
        names = {image["id"]: image["file_name"] for image in content["images"]}
        yield from ((name, []) for name in names.values())
        yield from ((names[one["image_id"]], [one]) for one in content["annotations"] if one.get("keypoints"))
        return
    entries = content["instance_info"] if isinstance(content, dict) else content
    if not entries or "keypoint_scores" in entries[0]:
        yield path.name, entries
    for one in entries:
        if "image_id" in one:
            yield one["image_id"], [one]
        elif "frame_id" in one:
            yield one["frame_id"], one["instances"]


def _joints(one: Any) -> Array:
    """Return the joints (n, 3) of an individual."""
    if "keypoint_scores" in one:
        return np.column_stack([one["keypoints"], one["keypoint_scores"]])
    return np.reshape(np.array(one["keypoints"], float), (-1, 3))


READER = JointReader(program="COCO, MMPose, AlphaPose", suffixes=(".json",), read=read)
