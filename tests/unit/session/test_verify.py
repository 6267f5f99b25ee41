"""Every lie that a session can tell is found, and the schema that is published is the one that is used."""

import hashlib
import json
from collections.abc import Callable
from functools import cache
from typing import Any

import jsonschema
import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_app.common.bounds import CENTURY_NS
from capture_app.common.names import IMAGE_SUFFIXES
from capture_app.session.format.manifest import (
    CALIBRATION,
    JOURNAL,
    MANIFEST,
    FrameRecord,
    ImageRecord,
    Manifest,
    WidenedTimes,
    session_schema_text,
)
from capture_app.session.reading import verify as verify_session
from capture_app.session.reading.checksums import CHECKSUMS, write_checksums
from capture_app.session.reading.decoding import decode_image, encode_image
from capture_app.session.reading.reader import Session, WritingState
from capture_app.session.reading.verify import Problem, ProblemKind, _clock_error, verify
from tests.project import ROOT

from .conftest import edit_manifest, jpeg

SCHEMA = ROOT / "docs" / "session.schema.json"
FIRST = "images/rig1/left/000000.jpg"


def rewrite(session: Session, change: Callable[[dict[str, Any]], Any], journal: bool = True) -> None:
    """Change the manifest, and journal and checksums with it, so that only the change itself is a lie."""
    manifest = edit_manifest(session, change)
    if journal:
        images = {(image["camera"], image["instant"]): image for image in manifest["images"]}
        lines = [json.dumps(image) for image in images.values()]
        (session.folder / JOURNAL).write_text("".join(line + "\n" for line in lines))
    write_checksums(session.folder, (session.folder / MANIFEST).read_bytes())


def first(**changes: object) -> Callable[[Session], None]:
    return lambda session: rewrite(session, lambda manifest: manifest["images"][0].update(changes))


def replace_first(data: bytes) -> Callable[[Session], None]:
    """Put another file in place of an image, and its checksum in the manifest."""

    def replace(session: Session) -> None:
        (session.folder / FIRST).write_bytes(data)
        first(bytes=len(data), sha256=hashlib.sha256(data).hexdigest())(session)

    return replace


def break_second(session: Session) -> None:
    """Cut off the end of the image of the second instant, as a broken encoder does."""
    data = jpeg(1)[:-100]
    (session.folder / FIRST.replace("00.", "01.")).write_bytes(data)
    changes = {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    rewrite(session, lambda manifest: manifest["images"][2].update(changes))


def flip(session: Session) -> None:
    path = session.folder / FIRST
    data = bytearray(path.read_bytes())
    data[-20] ^= 1
    path.write_bytes(data)


def swap_instants(session: Session) -> None:
    def swap(manifest: dict[str, Any]) -> None:
        times = manifest["burst"]["instants_ns"]
        times[1], times[2] = times[2], times[1]

    rewrite(session, swap)


def calibrate(name: str, width: int) -> Callable[[Session], None]:
    identity = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    camera = {"width": width, "height": 12, "fx": 1, "fy": 1, "cx": 1, "cy": 1,
              "rotation": identity, "translation": [0, 0, 0]}  # fmt: skip
    content = json.dumps({"cameras": {name: camera}})

    def give(session: Session) -> None:
        (session.folder / CALIBRATION).write_text(content)

    return give


def hold_within(tolerance_ns: int) -> Callable[[dict[str, Any]], None]:
    """Say how near to the grid the cameras were to be held."""
    phase = {"residual_ns": 0, "period_ns": 1, "drift_ppm": 0.0, "corrections": 0}

    def say(manifest: dict[str, Any]) -> None:
        for camera in manifest["cameras"]:
            camera["phase"] = {**phase, "tolerance_ns": tolerance_ns}

    return say


def recount(manifest: dict[str, Any]) -> None:
    """Make the record of the whole burst agree with its images."""
    manifest["sync"]["late"] = sum(image["late"] for image in manifest["images"])


def claim(change: Callable[[dict[str, Any]], Any], journal: bool = True) -> Callable[[Session], None]:
    """Change the manifest; see `rewrite`."""
    return lambda session: rewrite(session, change, journal)


def change_journal(session: Session, change: Callable[[list[bytes]], list[bytes]]) -> None:
    path = session.folder / JOURNAL
    path.write_bytes(b"".join(change(path.read_bytes().splitlines(keepends=True))))


def put(path: str, data: bytes) -> Callable[[Session], Any]:
    return lambda session: (session.folder / path).write_bytes(data)


def remove(path: str) -> Callable[[Session], None]:
    return lambda session: (session.folder / path).unlink()


def rename_first(session: Session) -> None:
    (session.folder / FIRST).rename(session.folder / "images/rig1/left/000007.jpg")


def repeat(manifest: dict[str, Any], time: str) -> None:
    """Give an image the time of the one before it."""
    manifest["images"][2][time] = manifest["images"][0][time]


def late_stamps(uncertainty_ns: int) -> Callable[[dict[str, Any]], None]:
    """Say of the first camera that its stamps are not exact."""
    stamp = {"bias_ns": 0, "uncertainty_ns": uncertainty_ns, "source": "assumed"}
    return lambda manifest: manifest["cameras"][0]["facts"].update(stamp=stamp)


EXACT = {"bias_ns": 0, "uncertainty_ns": 0, "source": "construction"}
TRUTH = "ground_truth/left/000000.npz"
AGAIN = {"camera": "left", "instant": 0, "reason": "?"}
LIES: dict[ProblemKind, dict[str, tuple[Callable[[Session], Any], str]]] = {
    "missing": {
        "image gone": (remove(FIRST), FIRST),
        "renamed": (rename_first, FIRST),
        "no journal": (remove(JOURNAL), "journal"),
        "no ground truth": (remove(TRUTH), "ground truth"),
    },
    "changed": {
        "image cut": (put(FIRST, b"x"), "1 bytes long"),
        "bit flipped": (flip, "sha256"),
        "swapped": (lambda s: put(FIRST, (s.folder / FIRST.replace("00.", "01.")).read_bytes())(s), FIRST),
        "no checksums": (remove(CHECKSUMS), "missing"),
        "torn checksums": (
            lambda s: put(CHECKSUMS, (s.folder / CHECKSUMS).read_bytes()[:-1])(s), "is incomplete",
        ),
        "other ground truth": (put(TRUTH, b"npy"), "000000.npz"),
    },
    "unreadable": {
        "broken, and not the first": (break_second, "decoded"),
        "no image": (replace_first(b"not an image"), "decoded"),
        "folder for image": (lambda s: (remove(FIRST)(s), (s.folder / FIRST).mkdir()), FIRST),
        "torn journal": (
            lambda s: put(JOURNAL, (s.folder / JOURNAL).read_bytes() + b'{"cam')(s), "line 6",
        ),
        "calibration broken": (put(CALIBRATION, b"{"), "calibration.json"),
        "ground truth broken": (put("ground_truth/times.json", b"[]"), "times.json"),
    },
    "unexpected": {
        "renamed to": (rename_first, "000007"),
        "stray image": (put("images/rig1/left/000009.jpg", b"x"), "000009"),
        "left over": (put(f"{FIRST}.part", b"x"), "interrupted write"),
    },
    "contradictory": {
        "other size": (replace_first(jpeg(0, 20, 12)), "20x12 pixels"),
        "surer than its stamps": (claim(late_stamps(21_000_000)), "its camera's stamps alone have 21000000"),
        "bound without one": (claim(late_stamps(10_000)), "its camera's stamps have none"),
        "residual": (first(residual_ns=4_001), "residual_ns is 4001"),
        "local time": (first(local_ns=1), "clock record"),
        "exposure start": (first(exposure_start_ns=1_000_004_001), "exposure_start_ns is 1000004001"),
        "late": (claim(lambda m: (hold_within(3_999)(m), recount(m))), "marked not late, 4000 ns"),
        "spread": (claim(lambda m: m["sync"].update(spread_ns=[13_000, 1, 0])), "sync.spread_ns is"),
        "dropped": (claim(lambda m: m["missing"][0].update(dropped=True)), "sync.dropped is 0"),
        "backwards": (claim(lambda m: repeat(m, "leader_ns")), "was not taken after"),
        "backwards by its own clock": (claim(lambda m: repeat(m, "local_ns")), "was not taken after"),
        "instants at once": (
            claim(lambda m: m["burst"]["instants_ns"].__setitem__(1, m["burst"]["instants_ns"][0])),
            "instant 1 is not after",
        ),
        "instants": (swap_instants, "instant 2 is not after"),
        "doubled": (claim(lambda m: m["images"].append(m["images"][0])), "2 images"),
        "hole": (claim(lambda m: m["missing"].clear()), "nor why"),
        "there and missing": (claim(lambda m: m["missing"].append(AGAIN)), "there and missing"),
        "journal differs": (
            claim(lambda m: m["images"][0].update(gain=9.0), journal=False),
            f"differs from the manifest in {FIRST}",
        ),
        "journal twice": (lambda s: change_journal(s, lambda lines: [*lines, lines[0]]), "line 6 repeats"),
        "journal has less": (lambda s: change_journal(s, lambda lines: lines[1:]), f"no entry for {FIRST}"),
        "journal has more": (claim(lambda m: m["images"].pop(0), journal=False), f"lacks {FIRST}"),
        "calibration of another": (calibrate("top", 16), "top"),
        "calibration of another size": (calibrate("left", 99), "99x12"),
    },
}  # fmt: skip


@pytest.mark.parametrize("suffix", IMAGE_SUFFIXES)
def test_an_eighth_of_the_size_fails_where_the_whole_does(suffix: str) -> None:
    """Verification decodes at an eighth of the size: a file that is cut off or changed must not pass so."""
    image = decode_image(jpeg(1), colour=True)
    assert image is not None
    data = encode_image(image.repeat(8, axis=0).repeat(8, axis=1), suffix)
    step = max(1, len(data) // 40)
    spoiled = [data[:place] for place in range(0, len(data), step)]
    spoiled += [data[:place] + bytes(step) + data[place + step :] for place in range(0, len(data), step)]
    refused = [decode_image(part) is None for part in spoiled]
    assert [decode_image(part, colour=True, min_width=1) is None for part in spoiled] == refused
    assert any(refused)


def test_an_honest_session_has_no_problems(session: Session) -> None:
    assert verify(session) == []
    calibrate("left", 16)(session)
    assert verify(session) == []


def test_a_machine_that_was_started_again_has_times_of_two_clocks(session: Session) -> None:
    def restart(m: dict[str, Any]) -> None:
        last = [image for image in m["images"] if image["camera"] == "left"][-1]
        last["local_ns"] -= 3_600_000_000_000
        spell = {
            "uncertainty_ns": 3_601_000_000_000,
            "hard_bound_ns": 3_601_000_000_000,
            "reason": "restarted",
        }
        at = {"from_local_ns": last["local_ns"] - 1, "until_local_ns": last["local_ns"] - 1}
        next(of for of in m["cameras"] if of["name"] == "left")["widened"] = [spell | at]

    claim(restart)(session)
    assert verify(Session.open(session.folder)) == []


@pytest.mark.parametrize(("kind", "lie"), [(kind, lie) for kind, lies in LIES.items() for lie in lies])
def test_every_lie_is_found(session: Session, kind: ProblemKind, lie: str) -> None:
    tell, what = LIES[kind][lie]
    tell(session)
    problems = verify(Session.open(session.folder))
    assert any(problem.kind is kind and what in str(problem) for problem in problems), problems


def test_checksums_of_what_is_no_file_of_a_session_are_not_followed(session: Session) -> None:
    """Whoever made the session would learn what other files have which contents."""
    (session.folder.parent / "secret").write_bytes(b"secret")
    with (session.folder / CHECKSUMS).open("a") as file:
        file.write(f"{'0' * 64}  ../secret\n{'0' * 10}  {JOURNAL}\n")
    problems = verify(Session.open(session.folder))
    assert [(of.where, of.what.partition(":")[0]) for of in problems] == [
        (CHECKSUMS, "has an unknown line")
    ] * 2


def test_a_time_within_its_error_bar_is_no_lie(session: Session) -> None:
    local_ns = session.manifest.images[0].local_ns
    assert local_ns is not None
    first(local_ns=local_ns + 20_900)(session)
    assert verify(Session.open(session.folder)) == []
    first(local_ns=local_ns + 21_100)(session)
    assert len(verify(Session.open(session.folder))) == 1


def test_a_time_is_as_unsure_as_a_doubt_says_from_its_beginning_on(session: Session) -> None:
    camera, record = session.manifest.cameras[0], session.manifest.images[0]
    assert record.local_ns is not None
    limits_ns = []
    for begins_ns in (record.local_ns + 1, record.local_ns):
        errors_ns = {"uncertainty_ns": 50_000, "hard_bound_ns": 50_000}
        doubt = WidenedTimes(from_local_ns=begins_ns, until_local_ns=begins_ns, reason="stepped", **errors_ns)
        limits_ns.append(
            _clock_error(session, record, msgspec.structs.replace(camera, widened=(doubt,)), 0)[1]
        )
    assert limits_ns[1] - limits_ns[0] == 50_000


def test_a_session_that_is_finished_while_it_is_verified_is_verified_anew(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    (session.folder / FIRST).write_bytes(b"not all of it yet")
    checked = list[Session]()

    def finish(of: Session, state: WritingState) -> list[Problem]:
        checked.append(of)
        assert len(checked) < 3, "it verifies what it has opened before"
        problems = check(of, state)
        replace_first(jpeg(1))(session)
        return problems

    check = verify_session._verify
    monkeypatch.setattr(verify_session, "_verify", finish)
    assert verify(session) == []
    assert len(checked) == 2
    assert checked[1].manifest != checked[0].manifest


def without(manifest: dict[str, Any], field: str) -> None:
    """Take a field from all images, as if it were not known."""
    for image in manifest["images"]:
        image.pop(field, None)


def without_clock(manifest: dict[str, Any]) -> None:
    """Say that the first camera's clock is not known, and that its stamps are not exact."""
    late_stamps(21_000_000)(manifest)
    manifest["cameras"][0].pop("clock")


def with_common_times(manifest: dict[str, Any]) -> None:
    """Say that the times are of the recordings' own, and that the first camera's stamps are not exact."""
    late_stamps(21_000_000)(manifest)
    manifest["burst"]["common_times"] = {"state": "unknown"}


def as_sure_as_its_stamps(manifest: dict[str, Any]) -> None:
    late_stamps(20_000)(manifest)
    without(manifest, "hard_bound_ns")


@pytest.mark.parametrize(
    "change",
    [
        lambda manifest: without(manifest, "local_ns"),
        lambda manifest: manifest["images"][2].pop("local_ns"),
        lambda manifest: manifest["cameras"][0]["facts"].update(stamp=EXACT),
        hold_within(9_000),
        lambda manifest: (without(manifest, "uncertainty_ns"), as_sure_as_its_stamps(manifest)),
        without_clock,
        with_common_times,
        as_sure_as_its_stamps,
    ],
)
def test_what_is_not_known_or_as_sure_as_it_may_be_is_no_lie(
    session: Session, change: Callable[[dict[str, Any]], Any]
) -> None:
    # What is computed of all images is another.
    rewrite(session, lambda manifest: (manifest.pop("sync"), change(manifest)))
    assert verify(Session.open(session.folder)) == []


@pytest.mark.parametrize(("ppm", "is_a_lie"), [(480, False), (-480, False), (700, True)])
def test_a_clock_may_be_slewed_during_a_recording(session: Session, ppm: int, is_a_lie: bool) -> None:
    later_ns = 10 * 10**9

    def slew(manifest: dict[str, Any]) -> None:
        *_, last = range(len(manifest["burst"]["instants_ns"]))
        manifest["burst"]["instants_ns"][last] += later_ns
        for image in manifest["images"]:
            if image["instant"] == last:
                image["leader_ns"] += later_ns
                image["local_ns"] += later_ns + ppm * later_ns // 10**6
                image.pop("exposure_start_ns", None)

    rewrite(session, slew)
    problems = verify(Session.open(session.folder))
    assert any("converted by the clock record" in str(problem) for problem in problems) is is_a_lie


def test_frames_of_a_short_recording_are_by_the_newest_clock_map(session: Session) -> None:
    image = session.manifest.images[0]
    camera = session.camera(image.camera)
    assert camera.clock is not None
    assert image.local_ns is not None
    _, allowed_ns = _clock_error(session, image, camera, 0)
    apart_ns = allowed_ns + camera.clock.uncertainty_ns // 2
    by_newer = msgspec.structs.replace(image, local_ns=image.local_ns + apart_ns)
    frame = FrameRecord(**msgspec.structs.asdict(by_newer), offset=0)

    def is_a_lie(record: ImageRecord) -> bool:
        error_ns, allowed_ns = _clock_error(session, record, camera, 0)
        return abs(error_ns) > allowed_ns

    assert is_a_lie(by_newer)
    assert not is_a_lie(frame)


def test_the_published_schema_is_the_one_in_use() -> None:
    assert SCHEMA.read_text() == session_schema_text()


def test_a_written_session_fits_the_published_schema(session: Session) -> None:
    schema = json.loads(SCHEMA.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    manifest = json.loads((session.folder / MANIFEST).read_text())
    validator.validate(manifest)
    manifest["images"][0]["camera"] = "../up"
    assert not validator.is_valid(manifest)


names = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", fullmatch=True)
times = st.integers(-CENTURY_NS, CENTURY_NS)
images = st.builds(
    ImageRecord,
    camera=names,
    instant=st.integers(0, 10**9),
    path=st.text(),
    leader_ns=times,
    bytes=st.integers(1, 2**40),
    sha256=st.from_regex(r"[0-9a-f]{64}", fullmatch=True),
    local_ns=st.none() | times,
    gain=st.none() | st.floats(-9e14, 9e14),
    substitute=st.booleans(),
)


@cache
def schema_in_use() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json.loads(session_schema_text()))


@settings(max_examples=40)
@given(st.lists(images, max_size=3), st.text(), st.lists(times, max_size=4))
def test_any_manifest_survives_the_disk(of: list[ImageRecord], note: str, instants: list[int]) -> None:
    base = {"name": "n", "created": "", "origin": "captured", "software": "", "cameras": (), "images": of}
    burst = {"instants_ns": instants, "period_ns": 1}
    manifest = msgspec.convert(msgspec.to_builtins({**base, "burst": burst, "note": note}), Manifest)
    data = msgspec.json.encode(manifest)
    assert msgspec.json.decode(data, type=Manifest) == manifest
    schema_in_use().validate(json.loads(data))
