"""A rig that is killed and that stands still in its takes: `make bench NAME=record`, in short."""

import socket
from argparse import Namespace
from pathlib import Path

import pytest

from benchmarks.sessions.recording import measure


@pytest.mark.timeout(600)
async def test_what_was_on_the_leaders_disk_stays_there_through_kills_and_outages(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = Namespace(cameras=1, seconds=2.0, kills=2, outages=1, within=0, port=port, seed=1)
    report = await measure(options, tmp_path)
    assert report["recording"]["problems"] == []
    assert [one["kind"] for one in report["interruptions"]] == ["kill", "kill", "outage"]
    for one in report["interruptions"]:
        assert (one["lost"], one["problems"]) == (0, []), one
    assert sum(one["confirmed"] for one in report["interruptions"]) > 0
