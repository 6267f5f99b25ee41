"""The Lab Streaming Layer's stream of a person: read back by pylsl, at the instant's time."""

import asyncio

import numpy as np
import pytest

from capture_app.companions.people.people_streams import LslStream
from tests.unit.companions.people.test_people_streams import FOUND, JOINTS

pylsl = pytest.importorskip("pylsl", reason="pylsl is not installed")


async def test_the_stream_has_each_joint_and_its_error() -> None:
    stream = LslStream()
    stream.send(FOUND)  # which opens it
    (found, *_) = await asyncio.to_thread(pylsl.resolve_byprop, "name", "simulshot person 2", 1, 30.0)
    inlet = pylsl.StreamInlet(found, processing_flags=pylsl.proc_none)
    await asyncio.to_thread(inlet.open_stream, 30.0)
    channel, labels = inlet.info().desc().child("channels").child("channel"), []
    while not channel.empty():
        labels.append((channel.child_value("label"), channel.child_value("unit")))
        channel = channel.next_sibling()
    assert labels[:4] == [("nose_X", "m"), ("nose_Y", "m"), ("nose_Z", "m"), ("nose_error", "m")]
    before_s = pylsl.local_clock()
    stream.send(FOUND)
    sample, at_s = await asyncio.to_thread(inlet.pull_sample, 30.0)
    assert sample[:8] == [*JOINTS["nose"], *JOINTS["left_hip"]]
    assert np.isnan(sample[8:]).all()
    assert before_s - 0.25 <= at_s <= pylsl.local_clock() - 0.25
