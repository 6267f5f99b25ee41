"""`burst --on-motion`: what moved is in the take with what was before it; nothing moving takes nothing."""

import asyncio
import json
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.rig import lead, output

from .conftest import Start


async def test_what_moves_is_in_the_take(start: Start, tmp_path: Path) -> None:
    _, address = await lead(start, tmp_path / "sessions")
    camera = "sim:phone-a,drops=0,outliers=0,scale=0.25,scene=studio"
    node = await start("node", "--name", "cam00", "--camera", camera, "--clock", "sim", "--leader", address)
    await node.says("ready")
    asked = ("--on-motion", "--frames", "12", "--before", "6", "--wait-s", "60", "--json")
    told = json.loads(await output(await start("burst", "--leader", address, *asked)))
    session = Session.open(Path(told["session"]))
    assert verify(session) == []
    assert len(session.manifest.images) == 12
    pictures = [
        cv2.imread(str(session.image_file(images["cam00"])), cv2.IMREAD_GRAYSCALE)
        for images in session.images_by_instant()
    ]
    steps = [np.percentile(cv2.absdiff(one, other), 99.5) for one, other in pairwise(pictures)]
    assert max(steps) > 15


async def test_a_still_picture_takes_nothing(start: Start, tmp_path: Path) -> None:
    _, address = await lead(start, tmp_path / "sessions")
    still = tmp_path / "still"
    (still / "cam").mkdir(parents=True)
    grey = np.kron(
        np.random.default_rng(0).integers(40, 200, (12, 16), np.uint8), np.ones((20, 20), np.uint8)
    )
    for number in range(2):
        cv2.imwrite(str(still / "cam" / f"{number}.jpg"), grey)
    camera = f"replay:{still},fps=30"
    node = await start("node", "--name", "a", "--camera", camera, "--clock", "sim", "--leader", address)
    await node.says("ready")
    watching = await start("burst", "--leader", address, "--on-motion")
    await watching.says("waiting for something to move")
    await asyncio.sleep(15)
    assert watching.process.returncode is None
    await watching.kill()
    assert not list((tmp_path / "sessions").glob("burst*"))
