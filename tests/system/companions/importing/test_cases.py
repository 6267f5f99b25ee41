"""The small inputs of shared/cases: each command does what expected.json says is right."""

import importlib.util
import json
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import pytest

from capture_app.common.errors import ExitCode
from capture_app.session.format.manifest import MANIFEST, ImageRecord
from capture_app.session.reading.decoding import decode_image
from capture_app.session.reading.reader import Session
from reconstruction.common.image_files import read_image

IMPORTS = (
    "timecode-zero", "timecode-editor", "timecode-unset-clock", "timecode-zero-claps", "summer-time-silent",
    "summer-time-claps", "timecode-in-sound", "tick-tables", "names-with-size", "names-of-copies",
    "names-of-clock", "names-of-date", "names-of-seconds-fast", "names-of-seconds-slow",
    "names-of-ten-digits", "calibration-of-more", "calibration-beside", "caliscope-fisheye",
    "caliscope-lenses", "caliscope-turned", "opencv-two-files", "opencv-byte-order-mark",
    "opencv-left-right", "png-upside-down", "png-on-its-side", "streamed-webm", "streamed-matroska",
    "trimmed", "av1", "interlaced", "ros-zero-stamps", "panorama-column",
)  # fmt: skip
MODULES = {"capture-app": "capture_app.cli", "reconstruct": "reconstruction.cli"}


@pytest.fixture(scope="module")
def make(shared: Path) -> ModuleType:
    """The module that makes the inputs."""
    spec = importlib.util.spec_from_file_location("cases_make", shared / "cases" / "make.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run_all(commands: Sequence[str], folder: Path) -> tuple[list[int], str]:
    """Run command lines in a folder; return their exit codes, and all that they printed."""
    codes, printed = [], ""
    for command in commands:
        program, *arguments = shlex.split(command)
        call = [sys.executable, "-m", MODULES[program], *arguments]
        done = subprocess.run(call, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
        codes.append(done.returncode)
        printed += done.stdout + done.stderr
    return codes, printed


def by_camera(session: Session) -> dict[str, list[ImageRecord]]:
    cameras: dict[str, list[ImageRecord]] = {}
    for image in sorted(session.manifest.images, key=lambda one: one.instant):
        cameras.setdefault(image.camera, []).append(image)
    return cameras


def check_counts(session: Session, expected: Mapping[str, Any]) -> None:
    cameras = by_camera(session)
    counts = {name: len(images) for name, images in cameras.items()}
    images = expected.get("images", counts)
    assert images in (counts, sum(counts.values()))
    assert expected.get("instants", len(session.manifest.burst.instants_ns)) == len(
        session.manifest.burst.instants_ns
    )
    missing = [[one.camera, one.instant] for one in session.manifest.missing]
    assert expected.get("missing", missing) == missing
    for name, first_ns in expected.get("first_ns", {}).items():
        assert cameras[name][0].leader_ns == first_ns
    if "apart_ms" in expected:
        for images_of in session.images_by_instant():
            times = [image.leader_ns for image in images_of.values()]
            assert max(times) - min(times) == pytest.approx(expected["apart_ms"] * 1e6)


def check_numbers(session: Session, expected: Mapping[str, Any], make: ModuleType) -> None:
    if not expected.keys() & {"equal_numbers", "first_numbers", "last_numbers"}:
        return
    numbers: dict[str, list[int]] = {}
    for images in session.images_by_instant():
        shown = {
            name: make.read_number(cv2.imread(str(session.image_file(of)))) for name, of in images.items()
        }
        assert not expected.get("equal_numbers") or len(set(shown.values())) == 1, shown
        for name, number in shown.items():
            numbers.setdefault(name, []).append(number)
    for place, key in ((0, "first_numbers"), (-1, "last_numbers")):
        for name, number in expected.get(key, {}).items():
            assert numbers[name][place] == number


def check_calibration(session: Session, expected: Mapping[str, Any]) -> None:
    calibration = session.calibration()
    for name, bad in expected.get("distortion_never", {}).items():
        assert calibration is None or list(calibration.cameras[name].distortion) != bad
    for key in ("fx", "fy", "translation"):
        for name, value in expected.get(key, {}).items():
            assert calibration is not None
            found = getattr(calibration.cameras[name], key)
            assert found == pytest.approx(tuple(value) if isinstance(value, list) else value)


def check_offsets(session: Session, expected: Mapping[str, Any]) -> None:
    if "offset" not in expected:
        return
    times = session.manifest.burst.common_times
    assert times is not None
    truth: dict[str, float] = expected["truth_offsets_ms"]
    if expected["offset"] == "found":
        assert times.state == "aligned"
        assert set(times.cameras) == set(truth)
    for name, of in times.cameras.items():
        true_ms = truth[name] - truth[times.reference]
        bar_ms = (of.uncertainty_ns or 0) / 1e6
        found_ms = (of.leader_from_local(of.epoch_local_ns) - of.epoch_local_ns) / 1e6
        assert abs(found_ms - true_ms) <= bar_ms + 1e-6
        if expected["offset"] == "found":
            assert abs(found_ms - true_ms) <= expected["within_ms"]


def sessions_below(folder: Path) -> list[Session]:
    return [Session.open(manifest.parent) for manifest in sorted(folder.rglob(MANIFEST))]


def check(case: str, expected: Mapping[str, Any], folder: Path, make: ModuleType) -> None:
    """Run a case's commands, and hold what they print and write against what is right."""
    codes, printed = run_all(expected["commands"], folder)
    if "exit_each" in expected:
        assert all(code in allowed for code, allowed in zip(codes, expected["exit_each"], strict=True)), (
            printed
        )
    else:
        allowed = {ExitCode.OK, ExitCode.BAD_INPUT} if expected["exit"] == "any" else set(expected["exit"])
        assert set(codes) <= allowed, printed
    for text in expected.get("never_say", ()):
        assert text not in printed
    for text in expected.get("say", ()):
        assert text in printed
    sessions = sessions_below(folder / "results")
    if codes[0] != ExitCode.OK:
        assert all(word in printed for word in expected.get("say_if_refused", ())), printed
        assert not sessions
        return
    for take in expected.get("takes", ()):
        assert ", ".join(f"{camera} = {file}" for camera, file in take.items()) in printed, printed
    for take in expected.get("forbidden_takes", ()):
        assert ", ".join(f"{camera} = {file}" for camera, file in take.items()) not in printed
    assert sessions
    following = [line.removeprefix("next: ") for line in printed.splitlines() if line.startswith("next: ")]
    codes_of_next, said = run_all(following, folder)
    assert len(following) == len(sessions)
    assert set(codes_of_next) == {ExitCode.OK}, (following, said)
    one = {**expected, **expected.get("if_imported", {})}
    for session in sessions:
        if set(codes) == {ExitCode.OK}:
            check_counts(session, one)
            check_numbers(session, one, make)
        check_calibration(session, one)
        check_offsets(session, one)
        for image in session.manifest.images if one.get("halves_agree") else ():
            path = session.image_file(image)
            assert (read_image(path) == decode_image(path.read_bytes(), colour=True)).all()


@pytest.mark.parametrize("case", IMPORTS)
def test_a_case_is_as_it_is_right(case: str, shared: Path, make: ModuleType, tmp_path: Path) -> None:
    expected = json.loads((shared / "cases" / "expected.json").read_text())[case]
    make.main([str(tmp_path), case])
    check(case, expected, tmp_path, make)
    also = expected.get("also")
    if also:
        for session in sessions_below(tmp_path / "results"):
            assert session.calibration() is not None
        (tmp_path / "results").rename(tmp_path / "first")
        check(case, also, tmp_path, make)
    if case == "panorama-column":
        picture = cv2.imread(str(next((tmp_path / "results").glob("**/panorama*.jpg"))))
        assert picture is not None
        assert picture.shape[0] > picture.shape[1]
