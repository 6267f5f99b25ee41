"""The page to walk round in: what it holds, and what a browser makes of it."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.depth.seen_moment import find_subject
from reconstruction.methods.view import walk_page
from reconstruction.methods.view.walk_page import write_moments
from tests.unit.reconstruction.depth.moments import BOARD_M, WALL_M, moment
from tests.unit.reconstruction.walk_pages import held, picture

NAME = "<b>clap</b>"


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """A page of two instants of a known moment."""
    write_moments(
        tmp_path / "view.html", NAME, {3: moment(), 4: moment()}, find_subject(moment()), 33_000_000
    )
    return tmp_path / "view.html"


def test_it_is_one_file_that_asks_nobody(page: Path) -> None:
    text = page.read_text()
    assert not re.search(r'(src|href)="(?!data:)', text)
    assert not re.search(r"https?://", text)
    assert NAME not in text
    assert "&lt;b&gt;clap&lt;/b&gt;" in text


def test_depth_comes_back_to_a_thousandth(page: Path) -> None:
    data = held(page)
    assert [one["instant"] for one in data["instants"]] == [3, 4]
    cameras = moment()
    for seen in data["instants"][0]["cameras"]:
        packed = picture(seen["depth"]).astype(int)
        level = (packed[..., 2] << 4) | (packed[..., 1] >> 4)
        inverse = 1 / seen["far"] + (level - 1) / 4094 * (1 / seen["near"] - 1 / seen["far"])
        truth = cameras[seen["camera"]].depth
        assert np.abs(np.where(level > 0, 1 / inverse, 0) / truth - 1).max() < 1e-3
        assert picture(seen["picture"]).shape == cameras[seen["camera"]].colours.shape


def test_its_path_lies_before_the_subject(page: Path) -> None:
    path = held(page)["path"]
    assert BOARD_M * 0.9 < path["distance"] < WALL_M * 1.1
    assert path["near"] < BOARD_M / 2
    assert path["far"] > WALL_M * 2


def steps_px(across: Array, down: Array) -> float:
    """Standard deviation of an edge's corners beside their straight line."""
    return float(np.std(across - np.polyval(np.polyfit(down, across, 1), down)))


MESH = """
const [bytes, wide, high] = JSON.parse(process.argv[1]), buffers = [];
globalThis.Image = class { width = wide; height = high; decode() {} };
const context = { drawImage() {}, getImageData: () => ({ data: bytes }) };
globalThis.document = { createElement: () => ({ getContext: () => context }) };
const keep = (_, data) => buffers.push(data);
const gl = new Proxy({}, { get: (_, name) => name === "bufferData" ? keep : () => 1 });
const [rotation, centre] = [[1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 0]];
const camera = { width: wide, height: high, lens: [1, 1, 0, 0], rotation, centre };
const painter = makePainter({ gl, data: { edge: 1.04, cameras: { camera } }, program() {}, texture() {} });
painter.build({ cameras: [{ camera: "camera", near: 1, far: 2 }] })
  .then(() => console.log(JSON.stringify([...buffers[0]])));
"""
"""Prints the corners that the page's script hands to the GPU: x, y, z, and the place in the picture."""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js")
def test_a_slanted_edge_has_half_its_steps_and_a_thin_part_its_width() -> None:
    """Two sticks before a wall, which lean by 0.3 px a row."""
    high, wide = 48, 80
    y, x = np.mgrid[:high, :wide]
    stick, thin = (np.abs(x - at - 0.3 * y) < width / 2 for at, width in ((20, 6.2), (50, 3.0)))
    packed = np.where((stick | thin)[..., None], (255, 240, 0, 255), (0, 16, 0, 255))
    script = Path(walk_page.__file__).with_name("page") / "meshes.js"
    given = json.dumps([packed.ravel().tolist(), wide, high])
    done = subprocess.run(
        ["node", "-e", script.read_text("utf-8") + MESH, given], capture_output=True, text=True, check=True
    )
    corners = np.array(json.loads(done.stdout)).reshape(high, wide, 5)
    places = corners[..., 3:] * (wide, high) - 0.5
    # Its rays have focal length 1 and their centre in the first corner.
    assert corners[..., :2] == pytest.approx(places * corners[..., 2:3], abs=1e-4)
    rows = np.arange(6, high - 6)
    for columns in (stick[rows].argmax(1), wide - 1 - stick[rows][:, ::-1].argmax(1)):
        assert steps_px(*places[rows, columns].T) < 0.55 * steps_px(columns, rows)
    first, last = thin[rows].argmax(1), wide - 1 - thin[rows][:, ::-1].argmax(1)
    thinner = np.mean(places[rows, last] - places[rows, first], axis=0)[0]
    assert thinner == pytest.approx(np.mean(last - first), abs=0.3)
    middle = np.rint(20 + 0.3 * rows).astype(int)
    assert places[rows, middle] == pytest.approx(np.column_stack([middle, rows]), abs=1e-4)
