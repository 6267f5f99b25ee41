"""What is said of a recording whose cameras have no common times."""

import shlex
from collections.abc import Callable
from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.companions.importing.aligning import _best_measured
from capture_app.session.alignment.alignment_method import AlignmentMethod
from capture_app.session.format.common_times import NOT_SYNCHRONIZED, CameraTimes, TimesState
from capture_app.session.library.listing import read_card
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import judge
from capture_app.session.reading.verify import verify
from tests.unit.companions.importing.numbered_video import write_video


def imported(folder: Path, *arguments: str) -> Session:
    assert (
        run(["sessions", "import", str(folder), "--out", str(folder.parent), "--name", "s", *arguments]) == 0
    )
    return Session.open(folder.parent / "s")


@pytest.fixture
def videos(tmp_path: Path) -> Path:
    for name in ("left", "right"):
        write_video(tmp_path / "rec" / f"{name}.mp4", [33_333 * n for n in range(6)])
    return tmp_path / "rec"


@pytest.mark.parametrize("arguments", [["--times", "video"], ["--fps", "30"]])
def test_two_videos_by_themselves_are_not_synchronized(
    videos: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    session = imported(videos, *arguments)
    times = session.manifest.burst.common_times
    assert times is not None
    assert times.state == "unknown"
    verdict = judge(session.manifest)
    assert (verdict.grade, verdict.spread_ns) == ("unknown", None)
    assert verdict.headline.startswith(NOT_SYNCHRONIZED)
    assert read_card(session.folder).unsynchronized
    assert verify(session) == []
    capsys.readouterr()
    assert run(["sessions", "show", str(session.folder)]) == ExitCode.OK
    shown = capsys.readouterr().out
    assert NOT_SYNCHRONIZED in shown
    assert "if the times are right" not in shown
    assert " apart at the median" not in shown


@pytest.mark.parametrize(
    ("arguments", "state"),
    [
        (["--fps", "30", "--synchronized"], "given"),
        (["--synchronized"], "given"),
        (["--time-shift-ms", "right=-33"], "given"),
        (["--times", "video", "--uncertainty-ms", "2"], "given"),
    ],
)
def test_what_the_user_says_of_the_times_is_kept_as_said(
    videos: Path, arguments: list[str], state: TimesState, capsys: pytest.CaptureFixture[str]
) -> None:
    session = imported(videos, *arguments)
    times = session.manifest.burst.common_times
    assert times is not None
    assert times.state is state
    assert NOT_SYNCHRONIZED not in capsys.readouterr().out


def test_equal_lengths_and_rates_are_a_question_and_the_next_command_works(
    videos: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(videos.parent)
    session = imported(videos)
    said = capsys.readouterr()
    assert session.manifest.burst.common_times is not None
    assert session.manifest.burst.common_times.unknown
    assert "2 videos of equal length and rate: if one trigger or recorder took their frames" in said.err
    assert "import again with --synchronized" in said.err
    assert max(map(len, said.out.splitlines())) < 200
    step = said.err.splitlines()[-1].removeprefix("next: capture-app ")
    assert run(shlex.split(step)) == ExitCode.OK
    write_video(videos / "right.mp4", [33_333 * n for n in range(5)])
    assert run(["sessions", "import", str(videos), "--out", str(videos.parent), "--name", "t"]) == ExitCode.OK
    assert "of equal length" not in capsys.readouterr().err


def test_numbered_images_and_tables_have_common_times(
    tmp_path: Path, make_images: Callable[..., Path]
) -> None:
    names = [f"{n}.png" for n in range(3)]
    folder = make_images("left", names).parent
    make_images("right", names)
    of_images = imported(folder, "--fps", "10").manifest.burst.common_times
    table = tmp_path / "times.csv"
    rows = [f"{camera},{n},{n / 10}" for camera in ("left", "right") for n in range(3)]
    table.write_text("\n".join(["camera,frame,time", *rows]))
    arguments = ["--out", str(tmp_path / "other"), "--name", "t", "--timestamps", str(table)]
    assert run(["sessions", "import", str(folder), *arguments]) == ExitCode.OK
    of_table = Session.open(tmp_path / "other" / "t").manifest.burst.common_times
    assert of_images is not None
    assert of_table is not None
    assert (of_images.state, of_table.state) == ("given", "recorded")


def test_one_camera_needs_no_common_times(tmp_path: Path) -> None:
    write_video(tmp_path / "rec" / "only.mp4", [0, 40_000])
    assert imported(tmp_path / "rec", "--times", "video").manifest.burst.common_times is None


@pytest.mark.parametrize(
    ("period_ms", "count", "step"), [(166, 5, "sheet"), (33, 5, "compare"), (33, 2, "sheet")]
)
def test_a_comparison_is_next_only_where_frames_are_as_far_apart_as_it_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], period_ms: int, count: int, step: str
) -> None:
    """Caliscope's recordings have six frames a second: `reconstruct compare` refuses them."""
    for name in ("cam_0", "cam_1"):
        write_video(tmp_path / "rec" / f"{name}.mp4", [period_ms * 1000 * n for n in range(count)])
    size = "size = [64, 48]\nmatrix = [[60.0, 0.0, 32.0], [0.0, 60.0, 24.0], [0.0, 0.0, 1.0]]\n"
    pose = (
        "distortions = [0.0, 0.0, 0.0, 0.0, 0.0]\nrotation = [0.0, 0.0, 0.0]\ntranslation = [{}, 0.0, 0.0]\n"
    )
    cameras = [f'[cam_{n}]\nname = "cam_{n}"\n{size}{pose.format(n / 10)}' for n in range(2)]
    (tmp_path / "rec" / "calibration.toml").write_text("\n".join(cameras))
    command = ["sessions", "import", str(tmp_path / "rec"), "--out", str(tmp_path), "--name", "s"]
    assert run([*command, "--synchronized", "--fit", "scale"]) == ExitCode.OK
    assert f" {step} " in capsys.readouterr().err.splitlines()[-1]


def method(doubt: str) -> AlignmentMethod[object]:
    return AlignmentMethod(
        priority=0,
        of_video_times=False,
        read=lambda path, first_s: None,
        match=lambda reference, camera, sound_error_s: CameraTimes(),
        doubt=lambda times: doubt,
    )


@pytest.mark.parametrize(("doubts", "offset_ns"), [(True, 5), (False, 10**9)])
def test_a_result_in_doubt_contradicts_none_that_proves_itself(*, doubts: bool, offset_ns: int) -> None:
    """Sound is trusted more than flashes, but not where it fits at several places."""
    sound = CameraTimes(offset_ns=10**9, uncertainty_ns=1)
    flash = CameraTimes(offset_ns=5, uncertainty_ns=100)
    measured = {"sound": lambda first, second: sound, "flash": lambda first, second: flash}
    methods = {"sound": method("an echo" * doubts), "flash": method("")}
    assert _best_measured("left", "right", measured, methods, trusting=False).offset_ns == offset_ns
