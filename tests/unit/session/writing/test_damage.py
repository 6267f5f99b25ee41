"""Flipped bits, torn journals and damaged images are noticed, and repaired where they can be."""

import json
import random
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.session.format.burst_plan import PLAN, read_plan
from capture_app.session.format.manifest import JOURNAL, MANIFEST
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.unit.session.writing.full_take import Take


def noticed(folder: Path) -> bool:
    try:
        return bool(verify(Session.open(folder)))
    except SimulshotError:
        return True


def flipped_bits(folder: Path, places: Callable[[int], Iterator[int]]) -> list[str]:
    """Flip one bit after the other, and return those that nobody noticed."""
    silent = []
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        data = path.read_bytes()
        for place in places(8 * len(data)):
            changed = bytearray(data)
            changed[place // 8] ^= 1 << place % 8
            path.write_bytes(changed)
            if not noticed(folder):
                silent.append(f"{path.name} bit {place}")
        path.write_bytes(data)
    return silent


def test_flipped_bits_are_noticed_wherever_they_are(tmp_path: Path) -> None:
    session = Take(tmp_path).write()
    assert verify(session) == []
    chance = random.Random(1)
    assert flipped_bits(session.folder, lambda bits: iter(chance.sample(range(bits), 12))) == []
    assert verify(session) == []


def test_a_journal_cut_anywhere_in_its_last_line_is_noticed_and_repaired(tmp_path: Path) -> None:
    take = Take(tmp_path)
    journal = take.write().folder / JOURNAL
    data = journal.read_bytes()
    begin = data.rindex(b"\n", 0, -1) + 1
    for length in (*range(begin, len(data) - 2, 3), len(data) - 2, len(data) - 1):
        journal.write_bytes(data[:length])
        assert noticed(take.folder), length
        if length % 64 < 3 or length > len(data) - 2:
            take.check_repaired()
            assert journal.read_bytes() == data


def test_a_torn_journal_of_an_unfinished_session_costs_one_image(tmp_path: Path) -> None:
    take = Take(tmp_path)
    writer = take.begin()
    for instant in range(3):
        take.add(writer, "cam0", instant)
    writer.abort()
    journal = take.folder / JOURNAL
    data = journal.read_bytes()
    for cut in (1, 2, 100, len(data) - data.rindex(b"\n", 0, -1) - 1):
        journal.write_bytes(data[:-cut])
        for gone in (MANIFEST, "checksums.sha256"):
            (take.folder / gone).unlink(missing_ok=True)
        kept = take.confirmed.copy()
        # Without its newline the last line may be whole, and then it counts.
        if cut > 1:
            del take.confirmed["cam0", 2]
        session = take.check_repaired()
        assert len(session.manifest.images) == len(take.confirmed)
        take.confirmed = kept
        aside = take.folder / "set_aside/images/rig1/cam0/000002.jpg"
        if cut > 1:
            aside.replace(take.folder / "images/rig1/cam0/000002.jpg")


def test_damaged_images_are_set_aside_and_said_to_be_lost(tmp_path: Path) -> None:
    take = Take(tmp_path)
    take.write()
    file = take.folder / "images/rig1/cam0/000001.jpg"
    damaged = file.read_bytes()[:-1] + b"!"
    file.write_bytes(damaged)
    del take.confirmed["cam0", 1]
    session = take.check_repaired()
    (gone,) = session.manifest.missing
    assert (gone.camera, gone.instant) == ("cam0", 1)
    assert "damaged" in gone.reason
    assert (take.folder / "set_aside/images/rig1/cam0/000001.jpg").read_bytes() == damaged


def test_an_impossible_number_in_a_plan_costs_its_camera_or_the_plan(tmp_path: Path) -> None:
    take = Take(tmp_path)
    take.begin().abort()
    file, huge = take.folder / PLAN, 10**40
    plan = json.loads(file.read_bytes())
    plan["cameras"][0]["camera"]["facts"]["width"] = huge
    file.write_text(json.dumps(plan))
    read = read_plan(take.folder)
    assert [part.camera.name for part in read.cameras] == ["cam1"]
    assert "cam0 is left out" in read.note
    plan["burst"]["period_ns"] = huge
    file.write_text(json.dumps(plan))
    with pytest.raises(BadInputError, match=r"burst\.period_ns"):
        read_plan(take.folder)
