"""Manifests of many images: read in pieces and packed, with the content and the errors of a whole reading."""

import json
from pathlib import Path
from typing import Any

import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.session.files.untrusted_files import indented
from capture_app.session.format import stored_manifest
from capture_app.session.format.manifest import MANIFEST, Manifest
from capture_app.session.format.stored_manifest import PackedImages, read_manifest
from capture_app.session.library.changes import set_note
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify


@pytest.fixture
def packed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored_manifest, "LARGE_BYTES", 0)
    monkeypatch.setattr(stored_manifest, "_PIECE_BYTES", 900)


@pytest.fixture
def whole(session: Session) -> Manifest:
    """The session's manifest, read whole: requested before `packed`."""
    return session.manifest


def test_packed_images_are_the_images(whole: Manifest, session: Session, packed: None) -> None:
    opened = Session.open(session.folder)
    images = opened.manifest.images
    assert isinstance(images, PackedImages)
    assert len(images._packs) > 2
    assert list(images) == list(whole.images)
    assert [images[place] for place in range(len(images))] == list(whole.images)
    assert images[-1] == whole.images[-1]
    assert list(images[1:-1]) == whole.images[1:-1]
    assert list(reversed(images)) == list(reversed(whole.images))
    with pytest.raises(IndexError):
        images[len(images)]
    assert (opened.manifest.burst, opened.manifest.sync) == (whole.burst, whole.sync)
    assert verify(opened) == []


def test_a_packed_session_is_shown_and_given_a_note(
    session: Session, packed: None, capsys: pytest.CaptureFixture[str]
) -> None:
    set_note(session.folder, "in the kitchen")
    assert run(["sessions", "show", str(session.folder), "--json"]) == ExitCode.OK
    shown = json.loads(capsys.readouterr().out)["manifest"]
    assert shown["note"] == "in the kitchen"
    assert [image["sha256"] for image in shown["images"]] == [one.sha256 for one in session.manifest.images]
    assert run(["sessions", "verify", str(session.folder)]) == ExitCode.OK


def damaged(content: dict[str, Any], what: str) -> bytes:
    images = content["images"]
    if what == "unknown camera":
        images[-1]["camera"] = "nobody"
    elif what == "unknown instant":
        images[-1]["instant"] = 10**6
    elif what == "wrong number":
        images[-1]["bytes"] = -1
    elif what == "braces in a path":
        images[-1]["path"] = "images/rig1/}, {/}]"
    elif what == "no images":
        content |= {"images": []}
    data = indented(json.dumps(content).encode())
    return data[: len(data) // 2] if what == "cut off" else data


@pytest.mark.parametrize(
    "what", ["unknown camera", "unknown instant", "wrong number", "braces in a path", "no images", "cut off"]
)
def test_what_is_unusual_is_read_or_refused_as_if_read_whole(
    session: Session, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    path = session.folder / MANIFEST
    path.write_bytes(damaged(json.loads(path.read_text()), what))

    def outcome() -> str:
        try:
            return str(list(read_manifest(path).images))
        except BadInputError as error:
            return str(error)

    expected = outcome()
    monkeypatch.setattr(stored_manifest, "LARGE_BYTES", 0)
    monkeypatch.setattr(stored_manifest, "_PIECE_BYTES", 900)
    assert outcome() == expected


@pytest.mark.parametrize("name", ["..", "a\\b.jpg", "linked.jpg"])
def test_a_path_that_leads_out_of_a_folder_of_plain_files_is_refused(
    session: Session, name: str, tmp_path: Path
) -> None:
    path = session.folder / MANIFEST
    content = json.loads(path.read_text())
    image = session.folder / content["images"][-1]["path"]
    if name == "linked.jpg":
        (image.parent / name).symlink_to(tmp_path)
        Session.open(session.folder)  # the manifest does not name it
    content["images"][-1]["path"] = f"{Path(content['images'][-1]['path']).parent.as_posix()}/{name}"
    path.write_text(json.dumps(content))
    with pytest.raises(BadInputError, match="outside the session"):
        Session.open(session.folder)
