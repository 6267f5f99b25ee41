"""Frames of a recording are pictures of a dataset as images of a burst are."""

from pathlib import Path

import numpy as np
import pytest

from capture_app.common.errors import IncompleteError
from capture_app.session.format.manifest import BurstRecord
from capture_app.session.reading.decoding import decode_image
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.scene.dataset import Dataset
from tests.project import JUMPER

SAMPLE = JUMPER


def test_a_dataset_reads_the_frames_of_videos(tmp_path: Path) -> None:
    burst = Dataset.open(SAMPLE).session
    writer = SessionWriter.create(tmp_path, "recorded")
    for image in burst.manifest.images:
        writer.save([StoredImage(image, burst.image_bytes(image))], in_videos=True)
    instants_ns, period_ns = burst.manifest.burst.instants_ns, burst.manifest.burst.period_ns
    writer.finish(burst.manifest.cameras, BurstRecord(instants_ns=instants_ns, period_ns=period_ns))

    dataset = Dataset.open(tmp_path / "recorded")
    camera = dataset.cameras[1]
    assert dataset.instants(*dataset.cameras) == Dataset.open(SAMPLE).instants(*dataset.cameras)
    as_jpeg = decode_image(dataset.image_bytes(camera, 1), colour=True)
    assert as_jpeg is not None
    np.testing.assert_array_equal(dataset.image(camera, 1), as_jpeg)
    np.testing.assert_array_equal(dataset.grey(camera, 1), Dataset.open(SAMPLE).grey(camera, 1))

    video = tmp_path / "recorded/videos/rig1" / f"{camera}.mjpeg"
    video.write_bytes(video.read_bytes()[:-1])
    with pytest.raises(IncompleteError, match="ends before the frame"):
        Dataset.open(tmp_path / "recorded")
