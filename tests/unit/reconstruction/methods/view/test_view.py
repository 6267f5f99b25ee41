"""`reconstruct view`: films and pictures of a session from places without a camera."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, ExitCode
from capture_app.session.reading.reader import Session
from reconstruction import open_session
from reconstruction.methods.view.view_run import ViewResult, write_film
from tests.unit.reconstruction.conftest import Reconstruct

RESULT = ViewResult(
    session="s", instants=(0,), condition="synced", cameras=("a", "b"), frames=4, width=32, height=24,
    seen=1.0, fps=25.0, left_out={},
)  # fmt: skip


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """Four views in a folder, each brighter than the one before."""
    folder = tmp_path / "made"
    (folder / "views").mkdir(parents=True)
    for number in range(4):
        cv2.imwrite(str(folder / f"views/{number:06d}.png"), np.full((24, 32, 3), 40 + 40 * number, np.uint8))
    return folder


def test_a_film_has_all_views_at_their_times(pictures: Path, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    write_film(tmp_path / "out.mp4", pictures, RESULT)
    with av.open(str(tmp_path / "out.mp4")) as film:
        frames = [(float(one.time), one.to_ndarray(format="bgr24").mean()) for one in film.decode(video=0)]
    assert [time for time, _ in frames] == pytest.approx([0, 0.04, 0.08, 0.12])
    assert [level for _, level in frames] == pytest.approx([40, 80, 120, 160], abs=2)


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_an_animation_needs_no_package(pictures: Path, tmp_path: Path, suffix: str) -> None:
    write_film(tmp_path / f"out{suffix}", pictures, RESULT)
    done, animation = cv2.imreadanimation(str(tmp_path / f"out{suffix}"))
    assert done
    assert [round(float(one[..., :3].mean()), -1) for one in animation.frames[:4]] == [40, 80, 120, 160]
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        (("--path", "nowhere.json"), ExitCode.BAD_INPUT, "nowhere.json"),
        (("--instants", "0,1", "--instant", "1"), ExitCode.USAGE, "either --instant or --instants"),
        (("--instant", "99"), ExitCode.BAD_INPUT, "no instant 99"),
    ],
)
def test_what_cannot_be_is_one_line(
    reconstruct: Reconstruct, boards: Session, tmp_path: Path, options: tuple[str, ...], code: int, says: str
) -> None:
    done = reconstruct("view", boards.folder, *options, "--out", tmp_path / "swing.gif")
    assert done.code == code
    assert says in done.err.splitlines()[-1]
    assert not (tmp_path / "swing.gif").exists()


def test_what_is_there_is_never_replaced_by_a_film(boards: Session, tmp_path: Path) -> None:
    (tmp_path / "x.mp4").mkdir()
    (tmp_path / "mine.gif").write_text("mine")
    for name in ("x.mp4", "mine.gif"):
        with pytest.raises(BadInputError, match="exists already"):
            open_session(boards.folder).view(out=tmp_path / name)
    assert (tmp_path / "mine.gif").read_text() == "mine"
    with pytest.raises(BadInputError, match="--page needs a folder"):
        open_session(boards.folder).view(out=tmp_path / "new.gif", page=True)
