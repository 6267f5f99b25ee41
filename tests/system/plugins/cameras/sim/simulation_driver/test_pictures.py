import io

import cv2
import numpy as np
import pytest

from tests.unit.plugins.cameras.sim.simulation_driver.stepped import frames_of, in_stepped_time, sim


@in_stepped_time
async def test_the_rendered_scene() -> None:
    pytest.importorskip("embreex", reason="scenes are rendered by Embree")
    camera = sim("sim:phone-a,scene=studio,scale=0.25", "cam02")
    frame = (await frames_of(camera, 1.0))[0]
    assert frame.encode_truth is not None
    image = cv2.imdecode(np.frombuffer(frame.picture.encode(), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (camera.facts.height, camera.facts.width, 3) == (120, 160, 3)
    assert np.asarray(image).std() > 20
    with np.load(io.BytesIO(frame.encode_truth())) as truth:
        assert truth["depth_m"].shape == (120, 160)
        assert 0.0 < truth["movers"].mean() < 0.5
        assert (truth["depth_m"][truth["movers"]] > 0.1).all()
