"""What vouches is what is delivered: the report's numbers are the score of files that its commands write."""

import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.session.exporting.point_cloud import read_ply
from capture_app.session.format.calibration import Calibration
from reconstruction.common.geometry import View
from reconstruction.methods.multiview.multiview_method import Multiview
from reconstruction.methods.panorama.panorama_method import Panorama
from reconstruction.methods.panorama.panorama_run import RegisteredInstant
from reconstruction.methods.panorama.registration import PanoramaStitcher
from reconstruction.methods.splat.gaussians import read_splats
from reconstruction.methods.splat.splat_method import SplatMethod
from reconstruction.methods.stereo.stereo_method import Stereo
from reconstruction.methods.stereo.stereo_pair import DepthMap
from reconstruction.methods.stereo.stereo_run import PairInstant, prepare_pair
from reconstruction.scene.conditions import SYNCED, Condition
from reconstruction.scene.instant_choice import instants_shown
from reconstruction.scene.scene import Scene
from tests.unit.reconstruction.conftest import Reconstruct
from tests.unit.reconstruction.found import study

SAMPLES = Path(__file__).parents[4] / "sample_sessions"
Read = Callable[[Any, Scene, Condition, Path], Iterator[Any]]


def multiview(method: Multiview, scene: Scene, condition: Condition, folder: Path) -> Iterator[Any]:
    assert method.instants is not None
    for k in method.instants:
        files = {name: folder / "depth" / name / f"{k:06d}.npz" for name in scene.dataset.cameras}
        maps = {}
        for name, file in files.items():
            if file.exists():
                with np.load(file) as data:
                    maps[name] = SimpleNamespace(depth=data["depth"], normals=data["normals"])
        cloud = read_ply(folder / "clouds" / f"{k:06d}.ply")
        points = cloud.points.astype(np.float32)
        yield SimpleNamespace(
            instant=k, maps=maps, cloud=SimpleNamespace(points=points, colours=cloud.colours)
        )


def stereo(method: Stereo, scene: Scene, condition: Condition, folder: Path) -> Iterator[PairInstant]:
    assert method.instants is not None
    assert method.pair is not None
    for k in method.instants:
        depth, difference = (
            cv2.imread(str(folder / f"{k}" / name), cv2.IMREAD_UNCHANGED)
            for name in ("depth_checked.tiff", "difference.tiff")
        )
        later = instants_shown(scene.dataset, condition, k)[method.pair[1]]
        pair = prepare_pair(scene, method.pair)
        yield PairInstant(method.pair, k, later, DepthMap(depth, difference), None, pair)


def panorama(
    method: Panorama, scene: Scene, condition: Condition, folder: Path
) -> Iterator[RegisteredInstant]:
    assert method.instants is not None
    assert method.pair is not None
    for k in method.instants:
        shown = instants_shown(scene.dataset, condition, k)
        written = (folder / f"{k}" / "registration.json").read_bytes()
        cameras = msgspec.json.decode(written, type=Calibration).cameras
        views = {name: View.from_calibration(one, one.width, one.height) for name, one in cameras.items()}
        registered = PanoramaStitcher(views, {})
        yield RegisteredInstant(k, {name: shown[name] for name in method.pair}, registered)


def splat(method: SplatMethod, scene: Scene, condition: Condition, folder: Path) -> Iterator[Any]:
    assert method.instants is not None
    for k in method.instants:
        yield None, read_splats(folder / "splats" / f"{k:06d}.ply")


def typed(line: str) -> Iterator[list[str]]:
    """The command lines of a line of the page, whose shell loop is unrolled."""
    if not line.startswith("for k in "):
        yield shlex.split(line)
        return
    instants, _, body = line.removeprefix("for k in ").removesuffix("; done").partition("; do ")
    for k in instants.split():
        yield shlex.split(body.replace("$k", k))


CASES: dict[str, tuple[type[Any], Read, str, Sequence[object]]] = {
    "multiview": (Multiview, multiview, "jumper", ("--max-multiview-instants", 2)),
    "multiview, naive": (Multiview, multiview, "naive", ("--max-multiview-instants", 1)),
    "multiview, pinwheel": (Multiview, multiview, "pinwheel", ("--max-multiview-instants", 1)),
    "stereo": (Stereo, stereo, "jumper", ("--max-instants", 2)),
    "stereo, crossing": (Stereo, stereo, "crossing", ("--max-instants", 2)),
    "stereo, naive": (Stereo, stereo, "naive", ("--max-instants", 2)),
    "stereo, pinwheel": (Stereo, stereo, "pinwheel", ("--max-instants", 2)),
    "panorama, crossing": (Panorama, panorama, "crossing", ("--max-instants", 2)),
    "splat": (SplatMethod, splat, "jumper", ("--splats",)),
}


@pytest.mark.parametrize("case", CASES)
def test_the_number_in_the_report_is_the_score_of_the_files(
    case: str, tmp_path: Path, reconstruct: Reconstruct, monkeypatch: pytest.MonkeyPatch
) -> None:
    method, read, sample, few = CASES[case]
    name = method.name
    compare = ("compare", SAMPLES / sample, "--study", name, *few, "--json")
    report = tmp_path / "report"
    first = study(reconstruct(*compare, "--out", report).result, name)
    assert set(first["commands"]) == {"synced", "offset"}
    monkeypatch.chdir(tmp_path)
    for line in first["commands"].values():
        assert line.replace("'", "&#39;") in (report / "report.html").read_text("utf-8")
        for words in typed(line):
            assert words[0] == "reconstruct"
            done = reconstruct(*words[1:])
            assert done.code == 0, done.err
    reads, run = list[str](), method.run
    late = shlex.split(first["commands"]["offset"].replace(";", " "))
    options = {SYNCED: "synced", late[late.index("--condition") + 1]: "offset"}
    # The curve of the tolerated delay has instants and delays of its own.
    asked = [row["instant"] for row in first["per_instant"]]

    def from_files(self: Any, scene: Scene, condition: Condition) -> Iterator[Any]:
        if condition.option not in options or list(self.instants) != asked:
            return run(self, scene, condition)
        reads.append(side := options[condition.option])
        return read(self, scene, condition, tmp_path / side)

    monkeypatch.setattr(method, "run", from_files)
    again = study(reconstruct(*compare, "--out", tmp_path / "again").result, name)
    assert set(reads) == {"synced", "offset"}
    assert first["measures"]
    assert rounded(again["measures"]) == rounded(first["measures"])
    assert rounded(again["per_instant"]) == rounded(first["per_instant"])


def rounded(found: Any) -> Any:
    """Numbers to more digits than any page prints."""
    if isinstance(found, dict):
        return {key: rounded(value) for key, value in found.items()}
    if isinstance(found, list):
        return [rounded(value) for value in found]
    return float(f"{found:.5g}") if isinstance(found, float) else found
