"""A list of sessions tells what is there now, whatever is in the folder."""

import shutil
from pathlib import Path

import msgspec
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.format.manifest import GROUND_TRUTH, MANIFEST
from capture_app.session.library.listing import (
    WIDTH_PX,
    SessionListing,
    best_synchronized,
    list_sessions,
    load_thumbnail,
)
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import edit_manifest, fill, jpeg


def test_what_a_card_shows(session: Session, tmp_path: Path) -> None:
    (card,) = SessionListing(tmp_path).read()
    assert (card.name, card.state, card.origin) == ("small", "complete", "simulated")
    assert (card.cameras, card.instants, card.images, card.missing) == (("left", "right"), 3, 5, 1)
    assert (card.spread_ns, card.uncertainty_ns, card.worst_ns) == (13_000, 20_000, 53_000)
    assert card.first_image == session.image_file(session.manifest.images[0])
    content = sum(image.bytes for image in session.manifest.images)
    truth = session.folder / GROUND_TRUTH
    assert card.size_bytes == content + sum(file.stat().st_size for file in truth.rglob("*.*"))
    assert card.size_bytes > content


def test_times_without_a_common_clock_have_no_spread(session: Session, tmp_path: Path) -> None:
    edit_manifest(session, lambda content: content["burst"].update(common_times={"state": "unknown"}))
    (card,) = SessionListing(tmp_path).read()
    assert (card.unsynchronized, card.spread_ns, card.worst_ns) == (True, None, None)


def test_a_session_is_shown_with_its_label_and_no_hidden_one_is(session: Session, tmp_path: Path) -> None:
    shutil.copytree(session.folder, tmp_path / ".hidden")
    assert [card.shown for card in list_sessions(tmp_path)] == ["small"]
    edit_manifest(session, lambda content: content.update(label="Sprung"))
    assert [card.shown for card in list_sessions(tmp_path)] == ["small (Sprung)"]
    with pytest.raises(BadInputError, match="no folder"):
        list_sessions(tmp_path / "nowhere")


def test_unfinished_and_broken_ones_say_what_to_do(tmp_path: Path) -> None:
    listing = SessionListing(tmp_path)
    writer = SessionWriter.create(tmp_path, "open")
    writer.add_image(jpeg(1), camera="left", instant=0, leader_ns=5)
    (card,) = listing.read()
    assert (card.state, card.remedy) == ("being saved", "wait until the burst is saved")
    writer.abort()
    (card,) = listing.read()
    assert card.state == "interrupted"
    assert "sessions repair" in card.remedy
    (writer.folder / MANIFEST).write_text('{"created": 1}')
    (card,) = listing.read()
    assert card.state == "unreadable"
    assert "$.created" in card.problem


def test_a_hostile_manifest_is_told_and_not_followed(session: Session, tmp_path: Path) -> None:
    edit_manifest(session, lambda content: content["images"][0].update(path="../../etc/passwd"))
    (card,) = SessionListing(tmp_path).read()
    assert card.state == "unreadable"
    assert "outside the session" in card.problem


def test_a_spread_of_hundreds_of_digits_is_told(session: Session, tmp_path: Path) -> None:
    edit_manifest(session, lambda content: content["sync"].update(spread_ns=[10**400]))
    (card,) = SessionListing(tmp_path).read()
    assert card.state == "unreadable"
    assert "<= 1000000000000000000" in card.problem


def test_the_best_synchronized_is_the_one_with_the_least_surely(session: Session, tmp_path: Path) -> None:
    fill(SessionWriter.create(tmp_path, "better"))
    edit_manifest(session, lambda content: content["sync"].update(spread_ns=[14_000]))
    listing = SessionListing(tmp_path)
    best = best_synchronized(listing.read())
    assert best is not None
    assert best.name == "better"
    # One that lacks an image is the best only among such.
    lacking = [msgspec.structs.replace(card, missing=int(card.name == "better")) for card in listing.read()]
    best = best_synchronized(lacking)
    assert best is not None
    assert best.name == session.folder.name
    # One whose error bars are not known cannot be the best.
    edit_manifest(session, lambda content: content["sync"].update(spread_ns=[0], uncertainty_ns=None))
    assert best_synchronized(listing.read()) is None


def test_thumbnails_are_kept_until_the_image_changes(tmp_path: Path) -> None:
    image, cache = tmp_path / "image.jpg", tmp_path / "cache"
    image.write_bytes(jpeg(1, width=640, height=480))
    first = load_thumbnail(cache, image)
    assert first is not None
    assert first.shape == (120, WIDTH_PX, 3)
    assert len(list(cache.iterdir())) == 1
    # JPEG keeps them to within a few grey levels.
    again = load_thumbnail(cache, image)
    assert again is not None
    assert abs(again.astype(int) - first).mean() < 12
    image.write_bytes(jpeg(2, width=320, height=320))
    second = load_thumbnail(cache, image)
    assert second is not None
    assert second.shape == (160, WIDTH_PX, 3)
    image.write_bytes(b"no image")
    assert load_thumbnail(cache, image) is None
    assert load_thumbnail(cache, tmp_path / "nowhere.jpg") is None


def test_thumbnails_are_made_where_none_can_be_kept(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "image.jpg").write_bytes(jpeg(1))
    assert load_thumbnail(tmp_path / "file" / "cache", tmp_path / "image.jpg") is not None


@pytest.mark.parametrize("name", ["burst-001", ".hidden", "notes"])
def test_other_folders_are_no_sessions(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    assert SessionListing(tmp_path).read() == []
