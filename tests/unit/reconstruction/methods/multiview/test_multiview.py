"""`reconstruct multiview`: its files, its figures, and its lines about what it cannot use."""

import shutil
import stat
import sys
from pathlib import Path

import numpy as np
import pytest

from capture_app.common.errors import BadInputError, NotApplicableError, NotAvailableError, SimulshotError
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import resize_view
from reconstruction.depth.rough_scene import RoughScene
from reconstruction.method.truth import depth_shares
from reconstruction.methods.multiview import colmap_workspace
from reconstruction.methods.multiview.colmap_workspace import (
    ENVIRONMENT,
    PROGRAM,
    find_gpu,
    read_array,
    read_maps,
    run_patch_match,
    write_workspace,
)
from reconstruction.methods.multiview.input_images import undistort_image, undistort_nearest
from reconstruction.methods.multiview.instant_maps import _why_alone
from reconstruction.methods.multiview.instant_model import MadeMultiview
from reconstruction.methods.multiview.multiview_method import Multiview
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from reconstruction.scene.dataset import Dataset
from tests.unit.reconstruction.conftest import Reconstruct, Scene, make_view, write_session
from tests.unit.reconstruction.depth.small_views import PLACES, photo_of, view_at
from tests.unit.reconstruction.methods.multiview.conftest import VIEWS


def test_a_rig_whose_calibration_nobody_knows_is_refused_where_that_is_asked_for(
    trio: Session, tmp_path: Path
) -> None:
    session = tmp_path / "session"
    shutil.copytree(trio.folder, session)
    (session / "calibration.json").unlink()
    with pytest.raises(NotApplicableError, match="no valid calibration of this rig is known"):
        Multiview(calibrated=True).make([session], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_depth_that_colmap_matched_has_no_confidence(tmp_path: Path) -> None:
    (tmp_path / "depth").mkdir()
    np.savez(tmp_path / "depth" / "left.npz", depth=np.ones((2, 3)), confidence=np.full((2, 3), 0.9))
    np.savez(tmp_path / "depth" / "right.npz", depth=np.ones((2, 3)))
    made = MadeMultiview(None, tmp_path)
    assert made.confidence("left") == pytest.approx(0.9)
    with pytest.raises(NotAvailableError, match="the depth of right has no confidence"):
        made.confidence("right")


def test_what_cannot_be_used_is_one_clear_line(
    trio: Session, scene: Scene, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    out = tmp_path / "out"
    at = ["multiview", trio.folder, "--out", out]
    late = reconstruct(*at, "--instant", 9)
    assert late.code == 3
    assert "no instant 9" in late.complaint
    assert "0 to 4" in late.complaint
    assert reconstruct(*at, "--condition", "1,2").complaint.count("left, middle, right") == 1
    assert "reach from 0 to 133 ms" in reconstruct(*at, "--condition", "-66,0,66").complaint
    assert reconstruct(*at, "--condition", "a,b,c").code == 2
    apart = {"left": VIEWS["left"], "away": make_view((0.2, 0, 0), yaw=58)}
    for name, views, problem in (
        ("lonely", {"only": VIEWS["left"]}, "one camera only"),
        ("apart", apart, "no camera sees what another sees"),
    ):
        session = write_session(tmp_path / name, scene, views, instants=1)
        refused = reconstruct("multiview", session.folder, "--out", out)
        assert refused.code == 3
        assert problem in refused.complaint
    (out / "mine").mkdir(parents=True)
    assert "holds other files (mine)" in reconstruct(*at).complaint
    assert sorted(path.name for path in tmp_path.iterdir()) == ["apart", "lonely", "out"]


def test_patchmatch_without_a_gpu_says_so(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reconstruct: Reconstruct
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    failed = reconstruct("multiview", trio.folder, "--matcher", "patchmatch", "--out", tmp_path / "out")
    assert failed.code == 6
    assert "this machine has none" in failed.complaint
    assert "--matcher sweep" in failed.complaint


def test_dark_cameras_are_left_out_by_name() -> None:
    with pytest.raises(BadInputError, match="same brightness"):
        undistort_image("left", 0, np.zeros((240, 320, 3), np.uint8), VIEWS["left"])


def test_a_camera_alone_in_its_step_of_a_staggered_rig_says_why_it_has_no_depth() -> None:
    images = {name: photo_of(view_at(*place))[0] for name, place in PLACES.items()}
    scene = RoughScene(dict.fromkeys(images, np.array([[0.0, 0.0, 2.0]])), {})
    steps_ns = {"left": 0, "middle": 0, "right": 10_000_000}
    why = _why_alone("right", images, scene, steps_ns)
    assert why == "no other camera takes its frames at the same time"


def test_truth_is_moved_as_the_picture_is(trio: Session) -> None:
    dataset = Dataset.open(trio.folder)
    shot = undistort_image("middle", 2, dataset.image("middle", 2), VIEWS["middle"])
    assert not shot.calibrated.view.distortion.any()
    ys, xs = np.mgrid[0:240, 0:320].astype(np.float32)
    plain_xs, plain_ys = (undistort_nearest(shot.view, axis) for axis in (xs, ys))
    assert 0.5 < np.hypot(plain_xs - xs, plain_ys - ys)[5:-5, 5:-5].max() < 8
    pixel = [float(plain_xs[20, 30]), float(plain_ys[20, 30])]
    ray = VIEWS["middle"].rays(np.array([pixel]))
    assert ray == pytest.approx(shot.calibrated.view.rays(np.array([[30.0, 20.0]])), abs=0.005)


@pytest.mark.parametrize("lens", ["straight", "distorted"])
def test_truth_is_as_small_as_the_pictures(lens: str) -> None:
    """`--width` makes maps smaller than the ground truth's files."""
    view = resize_view(VIEWS["middle"] if lens == "distorted" else VIEWS["middle"].undistorted, 160, 120)
    across = undistort_nearest(view, np.mgrid[0:240, 0:320][1].astype(np.float32))
    assert across.shape == (120, 160)
    assert across[60, 20:140] == pytest.approx(2 * np.arange(20, 140), abs=8)


def test_instants_are_the_nearest_to_the_offsets(trio: Session) -> None:
    dataset = Dataset.open(trio.folder)
    assert dataset.nearest_instants(1, ()) == {"left": 1, "middle": 1, "right": 1}
    assert dataset.nearest_instants(1, (-33, 0, 60)) == {"left": 0, "middle": 1, "right": 3}


def test_shares_count_what_is_empty_as_wrong() -> None:
    truth = np.array([[2.0, 2.0, 2.0, 2.0, 0.0]])
    depth = np.array([[2.01, 2.1, 0.0, 1.99, 3.0]])
    movers = np.array([[True, True, False, False, False]])
    shares = depth_shares(depth, truth, movers)
    assert all(shares[f"{part}within_2pct"] == 0.5 for part in ("", "mover_", "static_"))
    assert shares["mover_coverage"] == 1.0
    assert depth_shares(depth, np.zeros_like(truth), movers)["within_2pct"] is None


def fake(path: Path, text: str) -> Path:
    """A program that stands in for one this machine does not have."""
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def test_gpu_is_found_by_its_driver_and_the_other_environment_by_its_name(tmp_path: Path) -> None:
    there = {"PATH": str(tmp_path)}
    with pytest.raises(NotAvailableError, match="this machine has none"):
        find_gpu(there)
    fake(tmp_path / "nvidia-smi", "#!/bin/sh\nexit 9\n")
    with pytest.raises(NotAvailableError, match="this machine has none"):
        find_gpu(there)
    fake(tmp_path / "nvidia-smi", "not a program")
    with pytest.raises(NotAvailableError, match="the GPU does not answer: "):
        find_gpu(there)
    fake(tmp_path / "nvidia-smi", "#!/bin/sh\necho Some GPU\n")
    with pytest.raises(NotAvailableError, match="pycolmap-cuda12"):
        find_gpu(there)
    with pytest.raises(NotAvailableError, match="does not exist"):
        find_gpu(there | {ENVIRONMENT: str(tmp_path / "python")})
    found = find_gpu(there | {ENVIRONMENT: sys.executable})
    assert found == ("Some GPU", Path(sys.executable))


def test_patch_match_runs_in_another_process_and_its_death_is_told(tmp_path: Path) -> None:
    note = tmp_path / "asked"
    python = fake(tmp_path / "python", f'#!/bin/sh\nprintf "%s\\n" "$3" "$4" "$5" > {note}\n')
    gpu = "Some GPU", python
    run_patch_match(gpu, tmp_path / "workspace", 1.5, 4.0)
    assert note.read_text().split() == [str(tmp_path / "workspace"), "1.5", "4.0"]
    fake(python, "#!/bin/sh\necho no kernel image >&2\nexit 3\n")
    with pytest.raises(SimulshotError, match="exit code 3: no kernel image"):
        run_patch_match(gpu, tmp_path, 1.5, 4.0)
    fake(python, "#!/bin/sh\nkill -6 $$\n")
    with pytest.raises(SimulshotError, match="signal 6"):
        run_patch_match(gpu, tmp_path, 1.5, 4.0)


def test_maps_in_the_workspace_are_read_back(tmp_path: Path) -> None:
    view = VIEWS["left"]
    rng = np.random.default_rng(0)
    depth = rng.uniform(1, 3, (view.height, view.width)).astype(np.float32)
    depth[:50] = 0
    facing = np.zeros((view.height, view.width, 3), np.float32)
    facing[50:] = rng.normal(size=(view.height - 50, view.width, 3))
    picture = np.full((view.height, view.width, 3), 77, np.uint8)
    write_workspace(tmp_path, {"left": view}, {"left": picture}, {"left": ViewDepth(depth, facing)})
    found = read_maps(tmp_path, ["left"])["left"]
    assert np.array_equal(found.depth, depth)
    assert np.array_equal(found.normals, facing)
    assert (tmp_path / "stereo" / "fusion.cfg").read_text() == "left.png\n"
    broken = tmp_path / "broken.bin"
    broken.write_bytes(b"3&2&1&1234")
    with pytest.raises(SimulshotError, match="not a depth or normal map"):
        read_array(broken)


def test_the_cuda_module_is_never_imported_here() -> None:
    assert "pycolmap" in PROGRAM
    assert not hasattr(colmap_workspace, "pycolmap")
