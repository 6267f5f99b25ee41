"""Readers of joints that other programs found in images."""

from contextlib import suppress
from functools import cache
from pathlib import Path

from capture_app.common.errors import SimulshotError
from reconstruction.methods.people.joint_files import read_keypoints
from reconstruction.scene.dataset import Dataset
from tests.fuzz.folders import Reader, put
from tests.project import JUMPER


def read_joints(name: str) -> Reader:
    """The labels of two cameras, by their files' suffix."""

    def read(data: bytes, folder: Path) -> None:
        dataset = _jumper()
        cameras = dataset.cameras[:2]
        for camera in cameras:
            put(folder / f"{camera}{name}", data)
        with suppress(SimulshotError):
            read_keypoints(folder, dataset, cameras, "session")

    return read


@cache
def _jumper() -> Dataset:
    return Dataset.open(JUMPER)
