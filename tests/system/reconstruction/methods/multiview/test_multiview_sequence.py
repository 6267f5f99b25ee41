"""`reconstruct multiview --instants`: what is there is kept, and what would not belong is refused."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from capture_app.common.errors import BadInputError
from capture_app.session.exporting.point_cloud import read_ply
from capture_app.session.reading.reader import Session
from reconstruction.methods.multiview.multiview_method import Multiview
from tests.unit.reconstruction.conftest import Reconstruct, Scene, make_view, write_session

VIEWS = {
    "left": make_view((-0.14, 0.0, 0.0), yaw=1.5),
    "middle": make_view((0.0, 0.03, 0.0)),
    "right": make_view((0.14, 0.0, 0.0), yaw=-1.5),
}


@pytest.fixture(scope="module")
def trio(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Three cameras that see the boards at four instants; one has no picture of the last."""
    return write_session(tmp_path_factory.mktemp("trio"), scene, VIEWS, instants=4, missing={("left", 3)})


def test_a_sequence_is_made_at_the_chosen_instants_and_goes_on(scene: Scene, tmp_path: Path) -> None:
    pair = {name: VIEWS[name] for name in ("left", "right")}
    session, out = write_session(tmp_path / "session", scene, pair, instants=2), tmp_path / "out"
    options = Multiview(instants=(1, 1), depth=True, mesh=False, quick=True)
    made = options.make([session.folder], out)
    assert ([one.instant for one in made.instants], made.clouds, made.kept) == ([1], 1, 0)
    assert all((out / "depth" / name / "000001.npz").is_file() for name in pair)
    again = options.make([session.folder], out)
    assert (again.clouds, again.kept, again.instants) == (1, 1, made.instants)
    assert set(again.files) == {path.name for path in out.iterdir()}
    with pytest.raises(BadInputError, match="no instant 2"):
        replace(options, instants=(2,)).make([session.folder], tmp_path / "none")


def test_every_instant_has_its_cloud_and_what_moves_its_masks(
    trio: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    out = tmp_path / "out"
    result = reconstruct(
        "multiview", trio.folder, "--instants", "all", "--depth", "--out", out, "--json"
    ).result
    assert result["clouds"] == 4
    assert [one["cloud"] for one in result["instants"]] == [f"clouds/{k:06d}.ply" for k in range(4)]
    assert result["instants"][3]["left_out"] == {"left": "it has no image of instant 3"}
    for one in result["instants"][:3]:
        assert len(read_ply(out / one["cloud"]).points) == one["points"] > 5000
        assert one["mover_within_2pct"] > 0.8
        assert one["movers_1cm"]["f_score"] > 0.3
    with np.load(out / "depth" / "middle" / "000001.npz") as data:
        assert data["depth"].shape == (240, 320)
    mask = np.asarray(cv2.imread(str(out / "movers" / "middle" / "000002.png"), cv2.IMREAD_GRAYSCALE))
    assert 0.01 < float(np.mean(mask > 0)) < 0.3
    assert sorted(path.name for path in out.iterdir()) == sorted(result["files"])
    assert json.loads((out / "sequence.json").read_text())["clouds"] == 4


def test_a_killed_run_goes_on_where_it_was(trio: Session, tmp_path: Path, reconstruct: Reconstruct) -> None:
    out = tmp_path / "out"
    command = ["multiview", str(trio.folder), "--instants", "0-2", "--out", str(out)]
    running = subprocess.Popen([sys.executable, "-m", "reconstruction.cli", *command])
    first = out / "instants" / "000000.json"
    while not first.exists():
        assert running.poll() is None
        time.sleep(0.02)
    os.kill(running.pid, signal.SIGKILL)
    running.wait()
    before = {path: path.stat().st_mtime_ns for path in (out / "instants").iterdir()}
    assert not (out / "sequence.json").exists()
    result = reconstruct(*command, "--json").result
    assert result["clouds"] == 3
    assert result["kept"] == len(before) < 3
    assert all(path.stat().st_mtime_ns == at for path, at in before.items())
    assert not [path.name for path in out.iterdir() if path.name.startswith(".")]
    whole = reconstruct("multiview", trio.folder, "--instants", "0", "--out", tmp_path / "whole", "--json")
    assert whole.result["instants"][0]["points"] == result["instants"][0]["points"]


def test_what_a_killed_run_left_half_made_is_made_again(
    trio: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    out = tmp_path / "out"
    command = ["multiview", trio.folder, "--instants", "0", "--out", out, "--json"]
    whole = reconstruct(*command).result
    # Killed as it made its masks, and before that as it wrote a result, a plan, a cloud of another instant.
    (out / "movers").rename(out / "aside")
    (out / ".work").mkdir()
    (out / "aside").rename(out / ".work" / ".movers.part")
    for part in ("sequence.json.part", "plan.json.part", "clouds/000003.ply.part"):
        (out / part).write_bytes(b"half")
    again = reconstruct(*command).result
    assert (again["kept"], again["masks"], again["files"]) == (1, True, whole["files"])
    assert sorted(path.name for path in out.iterdir()) == sorted(whole["files"])
    assert [path.name for path in (out / "clouds").iterdir()] == ["000000.ply"]
    # A cloud that was taken away is to do, and without any the folder is free for other options.
    (out / "clouds" / "000000.ply").unlink()
    again = reconstruct(*command, "--depth").result
    assert again["clouds"] == 1
    assert "kept" not in again
    assert (out / "clouds" / "000000.ply").is_file()
    assert (out / "depth").is_dir()


def test_what_does_not_belong_is_refused_and_nothing_is_left(
    trio: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    out = tmp_path / "out"
    at = ["multiview", trio.folder, "--out", out]
    assert "it has 0 to 3" in reconstruct(*at, "--instants", "2-4").complaint
    assert "no instant is 999 ms" in reconstruct(*at, "--instants", "0", "--condition", "999").complaint
    assert not out.exists()
    assert "as in 0-9,20" in reconstruct(*at, "--instants", "3-1").complaint
    assert (
        "either --instant or --instants" in reconstruct(*at, "--instants", "all", "--instant", "1").complaint
    )
    assert reconstruct(*at, "--instants", "1").code == 0
    refused = reconstruct(*at, "--instants", "all", "--condition", "33")
    assert refused.code == 3
    assert "condition 'synced', not '33ms'" in refused.complaint
    # Of the time before still parts were kept, when nothing was said of them.
    plan = json.loads((out / "plan.json").read_text())
    del plan["whole"]
    (out / "plan.json").write_text(json.dumps(plan))
    assert "made with --whole" in reconstruct(*at, "--instants", "all").complaint
    assert "holds other files" in reconstruct(*at, "--instant", "1").complaint
    mine = tmp_path / "mine"
    (mine / "depth").mkdir(parents=True)
    assert "holds other files (depth)" in reconstruct(*at[:2], "--out", mine, "--instants", "1").complaint
    assert (mine / "depth").is_dir()
