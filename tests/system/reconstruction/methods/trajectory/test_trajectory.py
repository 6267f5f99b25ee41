"""A moving object is followed through space, by the time of each frame, or it is said why not."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from benchmarks.stagger.ball_path import MOTIONS, Motion, project, projections
from benchmarks.stagger.ball_session import EMPTY, PERIOD_NS, write_session
from capture_app.common.errors import ExitCode, NotApplicableError
from reconstruction.cli import run
from reconstruction.methods.trajectory.spline_path import OUTLIER, Rays, choose_path
from reconstruction.methods.trajectory.trajectory_method import TrajectoryMethod
from reconstruction.methods.trajectory.trajectory_run import TrajectoryResult
from tests.unit.reconstruction.conftest import VIEWS, Scene
from tests.unit.reconstruction.conftest import write_session as write_boards

SHAKEN = MOTIONS["shaken, 8 Hz"]


def rays(staggered: bool, motion: Motion = SHAKEN) -> tuple[Rays, np.ndarray]:
    """What four cameras at 30 see of a ball, in order of time."""
    rng = np.random.default_rng(3)
    seen = []
    for k in range(24):
        for place, projection in enumerate(projections()):
            at_s = (k + (place / 4 if staggered else 0)) / 30
            pixel = project(projection, motion(np.array([at_s])))[0][0] + rng.normal(0, 0.02, 2)
            seen.append((at_s, projection, pixel))
    seen.sort(key=lambda one: one[0])
    times_s = np.array([one[0] for one in seen])
    moments = np.concatenate([[0], np.cumsum(np.diff(times_s) > 1e-3)])
    return Rays(times_s, np.array([one[1] for one in seen]), np.array([one[2] for one in seen])), moments


def rms_mm(of: Rays, moments: np.ndarray) -> float:
    path, _ = choose_path(of, moments)
    judged_s = np.arange(0.1, 0.7, 0.001)
    return float(np.sqrt((((path.at(judged_s) - SHAKEN(judged_s)) ** 2).sum(1)).mean())) * 1e3


def test_a_staggered_rig_follows_what_one_in_step_cannot() -> None:
    assert rms_mm(*rays(staggered=True)) < 1.0
    assert rms_mm(*rays(staggered=False)) > 1.2


def test_frames_of_something_else_are_outliers() -> None:
    of, moments = rays(staggered=True, motion=MOTIONS["shaken, 2 Hz"])
    odd = np.zeros(len(of.times_s), bool)
    odd[::9] = True
    of.pixels[odd] += (120.0, -80.0)
    path, sd_px = choose_path(of, moments)
    found = path.residuals_px(of) > OUTLIER * sd_px
    assert found[odd].all()
    assert found[~odd].mean() < 0.05


def test_still_things_are_not_followed(scene: Scene, tmp_path: Path) -> None:
    session = write_boards(tmp_path, scene, VIEWS, frozen=True)
    with pytest.raises(NotApplicableError, match="one moving object is seen in 0 frames of 0 cameras"):
        TrajectoryMethod().make([session.folder], tmp_path / "path")


def test_a_thrown_ball_is_followed_in_two_steps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    thrown = MOTIONS["thrown in an arc"]
    session = write_session(tmp_path, thrown, "two steps", error_s=20e-6, seed=1)
    assert run(["trajectory", str(session), "--out", str(tmp_path / "path"), "--json"]) == ExitCode.OK
    result = msgspec.json.decode(capsys.readouterr().out, type=TrajectoryResult)
    assert len(result.points) == 96
    times_s = np.array([one.leader_ns for one in result.points]) / 1e9 - EMPTY * PERIOD_NS / 1e9
    off_m = np.linalg.norm(np.array([one.position for one in result.points]) - thrown(times_s), axis=1)
    assert (off_m < 1e-3).all()
    table = (tmp_path / "path" / "trajectory.csv").read_text().splitlines()
    assert table[0] == "time_s,x,y,z,uncertainty"
    assert len(table) == 97


def rolling(root: Path, speed_m_s: float) -> tuple[Path, Motion]:
    """A take of a slow ball that is in view from its first frame on, and the ball's path."""

    def motion(times_s: np.ndarray) -> np.ndarray:
        return np.stack([speed_m_s * (times_s - 0.8), 0.1 + 0 * times_s, 0.05 * times_s], axis=1)

    return write_session(root, motion, "in step", error_s=20e-6, seed=1, empty=0), motion


@pytest.mark.parametrize("speed_m_s", [0.3, 0.15])
def test_a_slow_ball_that_is_always_in_view_is_within_its_bars(speed_m_s: float, tmp_path: Path) -> None:
    session, motion = rolling(tmp_path, speed_m_s)
    result = TrajectoryMethod().make([session], tmp_path / "path")
    times_s = np.array([one.leader_ns for one in result.points]) / 1e9
    off_m = np.linalg.norm(np.array([one.position for one in result.points]) - motion(times_s), axis=1)
    bars_m = np.array([one.uncertainty for one in result.points])
    assert (off_m <= bars_m).mean() > 0.85
    assert bars_m.max() < 5e-3


def test_a_ball_that_the_background_shows_is_refused_with_what_to_do(tmp_path: Path) -> None:
    session, _ = rolling(tmp_path, 0.06)
    with pytest.raises(NotApplicableError, match="one moving object is seen in") as refused:
        TrajectoryMethod().make([session], tmp_path / "path")
    assert "by three times its width or more" in refused.value.hint


def test_cameras_that_see_different_things_move_have_no_path(tmp_path: Path) -> None:
    thrown, shaken = MOTIONS["thrown in an arc"], MOTIONS["shaken, 2 Hz"]

    def by_turns(times_s: np.ndarray) -> np.ndarray:
        """Whichever is larger in a view: by turns, as things pass before each other."""
        is_thrown = (np.floor(times_s * 10) % 2 == 0)[:, None]
        return np.asarray(np.where(is_thrown, thrown(times_s), shaken(times_s)))

    session = write_session(tmp_path, by_turns, "two steps", error_s=20e-6, seed=1)
    with pytest.raises(NotApplicableError, match="different things move"):
        TrajectoryMethod().make([session], tmp_path / "path")
    assert not (tmp_path / "path").exists()
