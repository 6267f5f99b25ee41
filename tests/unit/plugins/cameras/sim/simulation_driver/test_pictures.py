import io
import sys
import types
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.errors import BadInputError, NotAvailableError, SimulshotError
from capture_app.plugins.cameras.sim.rendering import scene as rendered_scene
from capture_app.session.format.calibration import Calibration, CameraCalibration
from tests.unit.plugins.cameras.sim.simulation_driver.stepped import Recorder, frames_of, in_stepped_time, sim


@in_stepped_time
async def shoot(name: str) -> CapturedFrame:
    return (await frames_of(sim("sim:perfect", name), 0.5))[7]


def test_pictures_are_reproducible_jpegs_that_differ_by_camera() -> None:
    first, again, right = (shoot(name).picture.encode() for name in ("left", "left", "right"))
    assert first == again
    assert first != right
    image = cv2.imdecode(np.frombuffer(first, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (480, 640, 3)
    assert np.asarray(image).std() > 40


@in_stepped_time
async def test_truth_is_an_npz_of_depth_objects_and_movers() -> None:
    frame = (await frames_of(sim("sim:perfect"), 0.2))[0]
    assert frame.encode_truth is not None
    with np.load(io.BytesIO(frame.encode_truth())) as truth:
        assert {truth[key].shape for key in truth} == {(480, 640)}
        kinds = {key: truth[key].dtype.name for key in truth}
    assert kinds == {"depth_m": "float32", "objects": "uint8", "movers": "bool"}


def test_a_scene_without_embree_is_refused_in_plain_words(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "embreex.py").write_text('raise OSError("libGL.so.1: cannot open shared object file")')
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "embreex"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(rendered_scene, "_built", rendered_scene._built.__wrapped__)
    with pytest.raises(NotAvailableError, match=r"libGL\.so\.1.*scene=bars") as error:
        sim("sim:pi,scene=pinwheel,scale=0.11")
    assert isinstance(error.value, SimulshotError)
    sim("sim:pi,scene=bars")


class StripedScene:
    """Stands in for a rendered scene and remembers what it was asked to render."""

    views: ClassVar = {"left": None, "right": None}

    def __init__(self) -> None:
        self.asked: list[tuple[Any, ...]] = []

    def render(self, *args: Any, seed: int) -> Any:
        self.asked.append((*args, seed))
        return np.full((90, 160, 3), 128, np.uint8)

    def ground_truth(self, *args: Any) -> Any:
        self.asked.append(args)
        return np.ones((90, 160), np.float32), np.ones((90, 160), np.uint8), np.ones((90, 160), np.bool_)

    def calibration(self) -> Calibration:
        identity = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        view = CameraCalibration(
            width=160, height=90, fx=1, fy=1, cx=0, cy=0, rotation=identity, translation=(0.0, 0.0, 0.0)
        )
        return Calibration(cameras=dict.fromkeys(self.views, view))


@pytest.fixture
def striped(monkeypatch: pytest.MonkeyPatch) -> StripedScene:
    scene = StripedScene()
    module: Any = types.ModuleType("scene")
    module.load = lambda name, *, scale, samples: scene
    for name in ("embreex", "capture_app.plugins.cameras.sim.rendering.scene"):
        monkeypatch.setitem(sys.modules, name, module)
    return scene


@in_stepped_time
async def test_a_scene_is_rendered_at_the_frames_true_start_when_it_is_saved(striped: StripedScene) -> None:
    camera = sim("sim:pi,scene=striped,view=right,drops=0")
    assert (camera.facts.width, camera.facts.height) == (160, 90)
    recorder = Recorder()
    frame, later = (await recorder.record(camera, 1.0))[:2]
    await camera.stop()
    assert striped.asked == []
    assert frame.encode_truth is not None
    frame.picture.encode()
    frame.encode_truth()
    frame.picture.encode()
    later.picture.encode()
    (view, start_ns, exposure_ns, row_time_ns, seed), truth, again, other = striped.asked
    assert (view, start_ns, exposure_ns, row_time_ns) == truth
    assert truth == ("right", frame.true_ns, frame.exposure_ns, 11_111)
    assert again[-1] == seed != other[-1]
    # 90 rows are read out in 1 ms.
    assert frame.exposure_ns is not None
    late_ns = recorder.arrivals_true_ns[0] - start_ns - frame.exposure_ns
    assert 2_999_000 <= late_ns <= 5_001_000


def test_a_scene_that_does_not_exist() -> None:
    pytest.importorskip("embreex", reason="scenes are rendered by Embree")
    with pytest.raises(BadInputError, match="studio"):
        sim("sim:pi,scene=moon")


def test_a_camera_tells_its_true_calibration_unless_asked_not_to(striped: StripedScene) -> None:
    assert sim("sim:pi,scene=striped,view=left").calibration is not None
    assert sim("sim:pi,scene=striped,view=left,calibration=none").calibration is None
    with pytest.raises(BadInputError, match="calibration=maybe"):
        sim("sim:pi,scene=striped,view=left,calibration=maybe")


def test_the_view_is_the_one_named_like_the_node(striped: StripedScene) -> None:
    sim("sim:pi,scene=striped", "left")
    with pytest.raises(BadInputError, match=r"no view 'cam00'.*left, right"):
        sim("sim:pi,scene=striped")
