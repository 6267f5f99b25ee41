"""Who is who in space: invariants over drawn scenes, exchanged names, and instants far from each other."""

import numpy as np
import pytest

from benchmarks.people.figure import Floats, moving, pixels_of, ring, seen_by
from benchmarks.people.scenes import draw, draw_take
from reconstruction.methods.people.keypoints import FrameJoints
from reconstruction.methods.people.people_run import CameraFrames, PeopleFinder
from reconstruction.methods.people.person_matching import Individual, Path, _joined, mirrored
from reconstruction.methods.people.skeletons import SKELETONS
from tests.unit.reconstruction.methods.people.takes import TIMES_S, errors_mm, finder, take

SKELETON = SKELETONS["blazepose"]
PAIR = [moving("walk", (0.0, -0.8)), moving("walk", (0.3, 0.8), heading=np.pi, phase=1.0)]


def names_of(frames: dict[str, CameraFrames], exchanged_from: int) -> dict[str, CameraFrames]:
    """Return a take whose people have names, which are exchanged in one camera from a frame on."""
    named = dict[str, CameraFrames]()
    for camera, one in frames.items():
        found = dict[int, FrameJoints]()
        for k, frame in one.joints.items():
            # Who is where is told by the truth.
            truth = [pixels_of(one.view, motion(one.frame_s[k : k + 1])[0]) for motion in PAIR]
            apart = [[np.abs(a - b).mean() for b in truth] for a in frame.pixels]
            order = [int(np.argmin(row)) ^ (camera == "cam1" and k >= exchanged_from) for row in apart]
            found[k] = FrameJoints(frame.pixels, frame.confidence, tuple("ab"[number] for number in order))
        named[camera] = one._replace(joints=found)
    return named


@pytest.mark.parametrize("kind", ["crossing", "embrace", "leaving", "mirror", "poster", "two cameras"])
def test_no_more_people_than_pictures_allow_never_two_on_a_body_and_each_detection_once(kind: str) -> None:
    scene = draw(kind, 3, 2, 1, seconds=1.0)
    people = PeopleFinder(scene.frames, SKELETON, 1 / 30)
    owned = np.zeros((3, len(scene.times_s)), int)
    for tracks in people.people:
        for track in tracks:
            owned[track.camera] += track.frames
    shown = np.array([[len(one.joints[k].pixels) for k in one.joints] for one in scene.frames.values()])
    assert (owned <= shown).all()
    pixels = np.array([[track.pixels for track in tracks] for tracks in people.people])
    for first in range(len(pixels)):
        for second in range(first):
            same = np.isfinite(pixels[first]) & (pixels[first] == pixels[second])
            assert not same.any()
    found = people.at(scene.times_s).people
    assert len(found) == len(scene.truth)
    for first in range(len(found)):
        for second in range(first):
            apart = np.linalg.norm(found[first].positions - found[second].positions, axis=2)
            both = np.isfinite(apart).any(axis=1)
            assert np.nanmedian(apart[both], axis=1).min() > 0.15
    owners = [
        {int(np.argmin([np.nanmedian(distances(one.positions[k], truth[k])) for truth in scene.truth]))
         for k in range(len(scene.times_s)) if np.isfinite(one.error[k]).any()}
        for one in found
    ]  # fmt: skip
    assert all(len(owner) == 1 for owner in owners)


def distances(joints: Floats, truth: Floats) -> Floats:
    return np.asarray(np.nan_to_num(np.linalg.norm(joints - truth, axis=1), nan=9.0))


def test_names_that_are_exchanged_in_one_camera_are_cut_and_said() -> None:
    times = TIMES_S[:24]
    people = finder(names_of(take(PAIR, cameras=3, times_s=times), 12))
    found = people.at(times).people
    assert len(found) == 2
    for person in found:
        errors = [errors_mm(person.positions, one, times) for one in PAIR]
        assert min(float(np.median(one, axis=1).max()) for one in errors) < 40
    assert sorted(people.remarks) == [
        f"in cam1, {name} is another individual from instant 12 on: the name was cut there" for name in "ab"
    ]


def test_names_that_hold_are_not_remarked() -> None:
    assert finder(names_of(take(PAIR, cameras=3, times_s=TIMES_S[:12]), 99)).remarks == []


def test_far_instants_are_matched_each_alone() -> None:
    frames = {
        f"cam{k}": seen_by(view, PAIR, np.array([0.0, 60.0, 120.0]), np.random.default_rng(k))
        for k, view in enumerate(ring(4, 150))
    }
    found = finder(frames).at(np.array([0.0, 60.0, 120.0])).people
    assert len(found) == 6
    assert all(np.isfinite(one.error).any(axis=1).sum() == 1 for one in found)
    for k, at_s in enumerate((0.0, 60.0, 120.0)):
        now = [one.positions[[k]] for one in found if np.isfinite(one.error[k]).any()]
        away = [min(errors_mm(joints, who, np.array([at_s])).mean() for who in PAIR) for joints in now]
        assert max(away) < 30


def test_who_is_found_twice_beside_a_poster_is_one() -> None:
    walk, times = moving("walk"), TIMES_S[:30]
    frames = take([walk], cameras=3, times_s=times)
    # From frame 8 on, the second detection in cam1 and the poster in cam0 agree on somebody nearer to cam1.
    aside, centre = walk(times) + np.array([0.0, 0.0, 0.12]), frames["cam1"].view.centre
    for name, joints in (("cam0", centre + 0.7 * (aside - centre)), ("cam1", aside)):
        pixels = pixels_of(frames[name].view, joints)
        found = dict(frames[name].joints)
        for k in range(8, len(times)):
            both = np.stack([frames[name].joints[k].pixels[0], pixels[k]])
            found[k] = FrameJoints(both, np.ones(both.shape[:2]))
        frames[name] = frames[name]._replace(joints=found)
    (person,) = finder(frames).at(times).people
    assert np.median(errors_mm(person.positions, walk, times)) < 30


def with_detections(
    frames: dict[str, CameraFrames], camera: str, pixels: dict[int, Floats]
) -> dict[str, CameraFrames]:
    """Return a take in whose camera somebody else is detected, by frame: pixels (joints, 2)."""
    found = dict(frames[camera].joints)
    for k, more in pixels.items():
        everybody = np.concatenate([found[k].pixels, more[None]]) if k in found else more[None]
        found[k] = FrameJoints(everybody, np.ones(everybody.shape[:2]))
    return frames | {camera: frames[camera]._replace(joints=found)}


def test_a_poster_and_a_second_detection_of_somebody_are_nobody() -> None:
    walk, times = moving("walk"), TIMES_S[:12]
    frames = take([walk], cameras=5, times_s=times)
    # A poster in cam0 agrees throughout with who is detected twice in cam1.
    centre = frames["cam1"].view.centre
    poster = centre + 0.7 * (walk(times) - centre)
    for camera, joints in (("cam0", poster), ("cam1", walk(times))):
        pixels = pixels_of(frames[camera].view, joints)
        frames = with_detections(frames, camera, dict(enumerate(pixels)))
    (person,) = finder(frames).at(times).people
    assert np.median(errors_mm(person.positions, walk, times)) < 30


def test_mistakes_of_two_cameras_among_eight_that_agree_for_a_while_are_nobody() -> None:
    times, other = TIMES_S[:24], moving("walk", (1.2, 0.5))
    frames = take([moving("walk")], cameras=8, times_s=times)
    for camera in ("cam2", "cam6"):
        pixels = pixels_of(frames[camera].view, other(times))
        frames = with_detections(frames, camera, {k: pixels[k] for k in range(4, 14)})
    assert len(finder(frames).people) == 1


def test_one_camera_alone_does_not_see_again_who_was_lost() -> None:
    times, walk = np.arange(40) / 20, moving("walk")
    frames = take([walk], cameras=3, times_s=times)
    for name, camera in frames.items():
        there = {*range(8), *range(32, 40), *([19] if name == "cam0" else [])}
        frames[name] = camera._replace(joints={k: camera.joints[k] for k in there})
    # Lost for 1.2 s, in which one mistake is where they were.
    assert len(finder(frames).people) == 2


def path(*steps: tuple[float, float]) -> tuple[Individual, Path]:
    """Somebody of 1.7 m at (time, place) of each step, m along an axis."""
    body = np.random.default_rng(0).normal(0, 0.5, (6, 3))
    one = Individual(body, np.zeros(6), 0.0, 1.7, np.zeros(3), confirmed=[round(10 * at) for at, _ in steps])
    return one, [(at, body + np.array([place, 0, 0]), 1.0) for at, place in steps]


def test_individuals_that_take_turns_in_one_place_are_one() -> None:
    first = path(*[(k / 10, 0.1 * k) for k in range(10) if k not in (4, 5, 6)])
    again = path(*[(k / 10, 0.1 * k + 0.05) for k in (4, 5, 6)])
    (one,) = _joined(dict([first, again]))
    assert one.confirmed == [*range(10)]
    beside = path(*[(k / 10, 0.1 * k + 0.5) for k in range(10)])
    elsewhere = path(*[(k / 10, 3.0) for k in (4, 5, 6)])
    later = path((4.0, 0.9))
    assert len(_joined(dict([first, beside, elsewhere, later]))) == 4


@pytest.mark.parametrize("kind", ["apart", "mirror"])
def test_cameras_that_face_each_other_do_not_carry_somebody_away(kind: str) -> None:
    # Detections of two people in such cameras agree on somebody between them.
    scene = draw_take(kind, 3, 45)
    assert len(PeopleFinder(scene.frames, SKELETON, 1 / 30).people) == len(scene.truth) == 2


def test_sides_are_told_by_names() -> None:
    names = ["Nose", "LHip", "RHip", "left_eye", "right_eye", "tail_L", "tail_R", "Left"]
    assert mirrored(names).tolist() == [0, 2, 1, 4, 3, 6, 5, 7]
