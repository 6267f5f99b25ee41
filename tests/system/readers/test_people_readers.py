"""Files of people in 3D, read by OpenSim, Pose2Sim, c3d and pygltflib themselves.

`make readers` installs the programs.
"""

from pathlib import Path

import numpy as np
import pytest

from reconstruction.methods.people.formats import c3d as c3d_format
from reconstruction.methods.people.formats import gltf
from reconstruction.methods.people.formats import trc as trc_format
from reconstruction.methods.people.skeletons import SKELETONS

pytestmark = pytest.mark.filterwarnings("ignore")  # of these programs, about what they import
SKELETON = SKELETONS["coco_17"]
TIMES_S = np.arange(12) / 60
POSITIONS = np.random.default_rng(5).uniform(-1, 1, (12, 17, 3))
POSITIONS[4:6, 3] = np.nan
KNOWN = np.isfinite(POSITIONS[..., 0])


@pytest.fixture
def trc(tmp_path: Path) -> Path:
    trc_format.write(tmp_path / "person1.trc", TIMES_S, SKELETON, [POSITIONS], "m")
    return tmp_path / "person1.trc"


def test_opensim_has_each_marker_at_each_time(trc: Path) -> None:
    opensim = pytest.importorskip("opensim", reason="opensim is not installed")
    table = opensim.TimeSeriesTableVec3(str(trc))
    assert list(table.getColumnLabels()) == [*SKELETON.joints]
    assert table.getTableMetaDataString("Units") == "m"
    assert list(table.getIndependentColumn()) == pytest.approx(TIMES_S, abs=1e-6)
    read = np.array([[table.getRowAtIndex(k)[j].to_numpy() for j in range(17)] for k in range(12)])
    assert read[KNOWN] == pytest.approx(POSITIONS[KNOWN], abs=1e-6)
    assert np.isnan(read[~KNOWN]).all()


def test_pose2sim_has_each_marker_at_each_time(trc: Path) -> None:
    common = pytest.importorskip("Pose2Sim.common", reason="pose2sim is not installed")
    coordinates, _, time, markers, _ = common.read_trc(trc)
    assert list(markers) == [*SKELETON.joints]
    assert np.array(time, float) == pytest.approx(TIMES_S, abs=1e-6)
    read = np.array(coordinates, float).reshape(12, 17, 3)
    assert read[KNOWN] == pytest.approx(POSITIONS[KNOWN], abs=1e-6)
    assert np.isnan(read[~KNOWN]).all()


def test_c3d_has_each_marker_and_gap(tmp_path: Path) -> None:
    c3d = pytest.importorskip("c3d", reason="c3d is not installed")
    c3d_format.write(tmp_path / "one.c3d", TIMES_S, SKELETON, [POSITIONS], "m")
    with (tmp_path / "one.c3d").open("rb") as file:
        reader = c3d.Reader(file)
        assert [label.strip() for label in reader.point_labels] == [*SKELETON.joints]
        assert reader.point_rate == 60
        frames = np.array([points for _, points, _ in reader.read_frames()])
    assert frames[..., :3][KNOWN] == pytest.approx(POSITIONS[KNOWN], abs=1e-6)
    assert (frames[..., 3][~KNOWN] == -1).all()


def test_pygltflib_has_each_joint_in_motion(tmp_path: Path) -> None:
    pygltflib = pytest.importorskip("pygltflib", reason="pygltflib is not installed")
    gltf.write(tmp_path / "people.gltf", TIMES_S, SKELETON, [POSITIONS, POSITIONS + 1], "m")
    document = pygltflib.GLTF2().load(str(tmp_path / "people.gltf"))
    (motion,) = document.animations
    names = [document.nodes[channel.target.node].name for channel in motion.channels]
    assert names == [f"person{k}_{joint}" for k in (1, 2) for joint in SKELETON.joints]
    assert [len(skin.joints) for skin in document.skins] == [17, 17]
    accessor = document.accessors[motion.samplers[17].output]
    view = document.bufferViews[accessor.bufferView]
    data = document.get_data_from_buffer_uri(document.buffers[0].uri)
    path = np.frombuffer(data, "<f4", 3 * accessor.count, view.byteOffset).reshape(-1, 3)
    assert path == pytest.approx(POSITIONS[:, 0] + 1, abs=1e-5)
