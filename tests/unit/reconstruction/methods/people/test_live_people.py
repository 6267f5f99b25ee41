"""People in 3D of one instant after the other: known by numbers, with errors that hold, and nobody else."""

from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np
import pytest

from benchmarks.people.figure import Floats, Motion, moving
from capture_app.common.errors import NotApplicableError
from capture_app.session.format.live_pictures import InstantImages, PeoplePreview
from reconstruction.common.geometry import Array
from reconstruction.methods.people import live_people as module
from reconstruction.methods.people import live_run
from reconstruction.methods.people.live_people import LivePeople
from reconstruction.methods.people.people_run import CameraFrames
from reconstruction.methods.people.skeletons import SKELETONS
from tests.unit.reconstruction.methods.people.takes import errors_mm, take

TIMES_S = np.arange(0, 3.0, 0.1)
RUN = moving("run", phase=0.4)


class Seen:
    """A detector that finds what was drawn: the number of the frame is in its image."""

    skeleton = SKELETONS["blazepose"]
    models = ("drawn",)
    search_every_s = 0.25
    takes: Mapping[int, CameraFrames]

    def __init__(self, model: str) -> None:
        assert model == "drawn"

    def detect(self, image: Array, at_s: float) -> tuple[Array, Array]:
        camera, frame = image[0, 0, :2].tolist()
        seen = self.takes[camera].joints[frame]
        return seen.pixels, seen.confidence


def live(frames: dict[str, CameraFrames], monkeypatch: pytest.MonkeyPatch) -> LivePeople:
    """What finds the people of a take."""
    monkeypatch.setattr(Seen, "takes", dict(enumerate(frames.values())), raising=False)
    monkeypatch.setattr(module, "load_detector", lambda *_: Seen)
    monkeypatch.setattr(module, "detector_bias", lambda _: (None, ""))
    return LivePeople(
        {name: one.view for name, one in frames.items()}, next(iter(frames.values())).view.width
    )


def images(frames: dict[str, CameraFrames], frame: int) -> dict[str, Array]:
    """The images of an instant."""
    found = {}
    for camera, (name, one) in enumerate(frames.items()):
        image = np.zeros((one.view.height, one.view.width, 3), np.uint8)
        image[0, 0, :2] = camera, frame
        found[name] = image
    return found


def errors(one: module.PersonNow, motion: Motion, at_s: float) -> Floats:
    """Distances of the joints from the truth, mm."""
    return errors_mm(one.positions[None], motion, np.array([at_s]))[0]


def test_a_person_has_one_number_and_errors_that_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = take([RUN], times_s=TIMES_S)
    people = live(frames, monkeypatch)
    away, within = [], []
    for k, at_s in enumerate(TIMES_S):
        found = people.find(images(frames, k), float(at_s))
        assert [one.number for one in found] in ([], [1])
        for one in found:
            away.append(errors(one, RUN, at_s))
            within.append(away[-1] <= one.error * 1e3)
    assert len(away) == len(TIMES_S)
    assert np.nanmedian(away) < 20
    assert 0.92 < np.mean(within[-15:]) < 0.99


def test_an_error_of_three_cameras_holds_where_one_sees_a_joint_elsewhere(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    walk, wrist = moving("walk"), SKELETONS["blazepose"].joints.index("left_wrist")
    frames, rng = take([walk], 3, times_s=TIMES_S), np.random.default_rng(7)
    for seen in frames["cam2"].joints.values():
        seen.pixels[0, wrist] += rng.uniform([-150, -20], [150, 20])
    people, within = live(frames, monkeypatch), []
    for k, at_s in enumerate(TIMES_S):
        for one in people.find(images(frames, k), float(at_s)):
            away = errors(one, walk, at_s)[wrist]
            within += [away <= one.error[wrist] * 1e3] * bool(np.isfinite(away))
    assert len(within) > 20
    assert np.mean(within) > 0.9


def test_numbers_stay_and_become_free(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = [moving("walk"), moving("walk", phase=0.5, place=(1.6, 1.0))]
    both, first = take(pair, times_s=TIMES_S), take(pair[:1], times_s=TIMES_S)
    people = live(both, monkeypatch)
    known = [people.find(images(both, k), 0.1 * k) for k in range(10)][-1]
    assert sorted(one.number for one in known) == [1, 2]
    here = next(one.number for one in known if np.nanmedian(errors(one, pair[0], 0.9)) < 60)
    monkeypatch.setattr(Seen, "takes", dict(enumerate(first.values())))
    for k in range(10, 30):
        assert [one.number for one in people.find(images(first, k), 0.1 * k)] == [here]


def test_a_slow_machine_shows_who_is_there_now(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = take([RUN], times_s=TIMES_S)
    people = live(frames, monkeypatch)
    assert [len(people.find(images(frames, k), 2.0 * k)) for k in range(0, 30, 10)] == [1, 1, 1]


def test_a_camera_that_gives_no_picture_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = take([RUN], times_s=TIMES_S)
    people = live(frames, monkeypatch)
    within = []
    for k, at_s in enumerate(TIMES_S):
        shown = images(frames, k)
        shown.pop("cam2")
        within += [errors(one, RUN, at_s) <= one.error * 1e3 for one in people.find(shown, float(at_s))]
    assert len(within) >= len(TIMES_S) - 6
    assert 0.88 < np.mean(within[-15:]) < 0.99


def test_what_is_sent_has_the_joints_and_the_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = take([RUN], times_s=TIMES_S)
    people = live(frames, monkeypatch)
    monkeypatch.setattr(live_run, "LivePeople", lambda *_: people)
    find = live_run.begin({}, "m")
    for k in range(8):
        found = find(InstantImages(k * 10**8, "cam1", {}), images(frames, k) | {"door": np.zeros((9, 9, 3))})
    (person,) = found.people
    assert (person.number, found.camera, found.unit) == (1, "cam1", "m")
    assert set(person.joints) <= set(found.joints) == set(SKELETONS["blazepose"].joints)
    assert all(len(row) == 4 and np.isfinite(row).all() for row in person.joints.values())
    assert found.jpeg.startswith(b"\xff\xd8")
    assert found.bones == SKELETONS["blazepose"].bones
    middle = np.median([row[:3] for row in person.joints.values()], axis=0)
    assert found.path["subject"] == pytest.approx(middle)
    assert 0 < found.path["near"] < found.path["distance"] < found.path["far"]
    assert found.path["limits"][0] * found.path["half"][0] > np.pi, "one walks all the way round them"
    rises = [
        found.path["middle"][1] + sign * found.path["limits"][1] * found.path["half"][1] for sign in (-1, 1)
    ]
    assert np.abs(rises).max() == pytest.approx(1.4), "but never over their heads"
    alone = find(InstantImages(9 * 10**8, "", {}), images(frames, 9))
    assert alone.jpeg == b""
    carried = msgspec.msgpack.decode(msgspec.msgpack.encode(alone), type=PeoplePreview)
    assert carried.path == alone.path | {"limits": [*alone.path["limits"]]}
    assert find(InstantImages(10**10, "", {}), {}).path == {}


def test_one_calibrated_camera_is_too_few(tmp_path: Path) -> None:
    with pytest.raises(NotApplicableError, match="not calibrated for two"):
        LivePeople({"cam0": take([RUN], 1)["cam0"].view})
