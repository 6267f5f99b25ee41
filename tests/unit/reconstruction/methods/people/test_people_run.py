"""People in 3D at one instant, by the time of each frame, with an error for each joint."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.people.figure import moving, seen_by
from reconstruction.common.geometry import resize_view
from reconstruction.methods.people.keypoints import FrameJoints
from tests.unit.reconstruction.methods.people.takes import STEP_S, TIMES_S, errors_mm, finder, take

INNER = TIMES_S[6:-6]
EVERY_OTHER = INNER[::2]
RUN = moving("run", phase=0.4)


def test_cameras_half_a_frame_apart_are_as_good_as_synchronized_ones_and_nearest_frames_are_not() -> None:
    times, taken = EVERY_OTHER[:18], TIMES_S[:48]
    (synced,) = finder(take([RUN], times_s=taken)).at(times).people
    late = finder(take([RUN], late=(0, 0.5, 0, 0.5), times_s=taken))
    (by_time,), (nearest,) = late.at(times).people, late.at(times, nearest=True).people
    best, own, paired = (
        float(errors_mm(one.positions, RUN, times).mean()) for one in (synced, by_time, nearest)
    )
    assert own < 1.1 * best < paired
    within = errors_mm(by_time.positions, RUN, times) <= by_time.error * 1e3
    assert 0.93 < within.mean() < 0.98


def test_bars_hold_where_some_cameras_have_fewer_pixels() -> None:
    frames, rng = take([RUN], noise_px=3.0), np.random.default_rng(2)
    for name in ("cam1", "cam3"):
        small = resize_view(frames[name].view, 640, 360)
        frames[name] = seen_by(small, [RUN], TIMES_S, rng, noise_px=1.0)
    (person,) = finder(frames).at(EVERY_OTHER).people
    within = errors_mm(person.positions, RUN, EVERY_OTHER) <= person.error * 1e3
    assert 0.93 < within.mean() < 0.98


def test_joints_are_exact_without_noise_at_any_rate_of_a_staggered_rig() -> None:
    walk = moving("walk")
    times = np.arange(0.1, 0.4, 1 / 240)
    staggered = take([walk], late=(0, 0.25, 0.5, 0.75), noise_px=0.01, times_s=TIMES_S[:30])
    found = finder(staggered).at(times)
    (person,) = found.people
    assert errors_mm(person.positions, walk, times).max() < 1.0
    assert found.moved_ms == pytest.approx(1000 * STEP_S / 4, rel=0.1)


def test_a_camera_that_is_late_unnoticed_shows_as_reprojection_error() -> None:
    frames = take([RUN], noise_px=1.0)
    people = finder(frames)
    (on_time,) = people.at(INNER).people
    (late,) = people.at(INNER, {"cam1": np.full(len(INNER), 0.066)}).people
    assert np.nanmedian(late.residual_px) > 1.2 * np.nanmedian(on_time.residual_px)
    assert late.cameras.mean() < on_time.cameras.mean() - 0.2


def test_two_people_who_pass_each_other_are_not_mixed() -> None:
    crossing = [moving("walk", (0.0, -0.5)), moving("walk", (0.3, 0.5), heading=np.pi, phase=1.0)]
    times = INNER[:33]
    found = finder(take(crossing, times_s=TIMES_S[:45])).at(times)
    assert len(found.people) == 2
    for person in found.people:
        errors = [
            float(np.nanmedian(errors_mm(person.positions, one, times), axis=1).max()) for one in crossing
        ]
        assert min(errors) < 60 < 200 < max(errors)


def test_what_one_camera_alone_sees_is_a_gap() -> None:
    frames = take([RUN], cameras=3)
    for name in ("cam1", "cam2"):
        blind = {
            k: FrameJoints(one.pixels, np.where(np.arange(33) == 16, 0.0, one.confidence))
            for k, one in frames[name].joints.items()
        }
        frames[name] = frames[name]._replace(joints=blind)
    (person,) = finder(frames).at(INNER).people
    unknown = np.isnan(person.error)
    assert unknown[:, 16].all()
    assert not np.delete(unknown, 16, axis=1).any()
    assert np.isnan(person.positions[:, 16]).all()


def test_half_a_person_has_half_of_the_joints() -> None:
    frames = take([RUN])
    low = {
        name: one._replace(view=replace(one.view, height=500)) for name, one in frames.items()
    }  # What is below is outside the image.
    (person,) = finder(low).at(INNER).people
    known = np.isfinite(person.error).mean(axis=0)
    assert known[0] == 1.0
    assert known[27] == 0.0


def test_a_camera_whose_picture_is_mirrored_is_not_believed() -> None:
    frames = take([RUN])
    mirrored = {
        k: FrameJoints(one.pixels * [-1, 1] + [frames["cam2"].view.width - 1, 0], one.confidence)
        for k, one in frames["cam2"].joints.items()
    }
    frames["cam2"] = frames["cam2"]._replace(joints=mirrored)
    found = finder(frames)
    assert 2 not in {track.camera for group in found.people for track in group if track.frames.any()}
    (person,) = found.at(INNER).people
    assert errors_mm(person.positions, RUN, INNER).mean() < 30
