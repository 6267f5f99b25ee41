"""People name cameras as their owners do, and read them so; results are keyed by the names."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from msgspec import Struct

from capture_app.common.errors import BadInputError
from capture_app.session.files.output_folder import OutputFolder
from capture_app.session.format.manifest import MANIFEST
from capture_app.session.reading.reader import Session
from reconstruction.commands.method_command import method_command
from reconstruction.method.interface import Method
from reconstruction.method.spoken import spoken
from reconstruction.scene.conditions import Condition
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.provenance import Provenance
from reconstruction.scene.scene import Scene

LABELS = {"left": "Böhm", "right": "カメラ右"}


@pytest.fixture(scope="module")
def labelled(boards: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The boards' session, of which an owner calls two cameras otherwise."""
    folder = tmp_path_factory.mktemp("labelled") / "boards"
    shutil.copytree(boards.folder, folder)
    manifest = json.loads((folder / MANIFEST).read_text())
    for camera in manifest["cameras"]:
        camera["facts"] |= {"label": LABELS[camera["name"]]} if camera["name"] in LABELS else {}
    (folder / MANIFEST).write_text(json.dumps(manifest))
    return folder


class Part(Struct, frozen=True):
    camera: str
    title: str
    offsets_ms: dict[str, float]
    pairs: tuple[tuple[str, ...], ...]
    rows: list[Any]


def test_a_result_is_spoken_with_labels_in_place_of_whole_names() -> None:
    part = Part("left", "left", {"left": 1.0, "mid": 2.0}, (("left", "right"),), [{"right": "a/right.jpg"}])
    said = spoken(part, LABELS)
    assert said == Part(
        "Böhm", "left", {"Böhm": 1.0, "mid": 2.0}, (("Böhm", "カメラ右"),), [{"カメラ右": "a/right.jpg"}]
    )
    assert spoken(part, {}) == part


def test_a_condition_names_cameras_as_their_owners(labelled: Path) -> None:
    dataset = Dataset.open(labelled)
    asked = Condition.parse("カメラ右=66@Bo\u0308hm").named(dataset)
    assert (asked.named_ms, asked.anchor) == ((("right", 66.0),), "left")
    assert Condition.parse("right=66").named(dataset).named_ms == (("right", 66.0),)
    for text in ("nobody=66", "66@nobody"):
        with pytest.raises(BadInputError, match="--condition names nobody, which the recording lacks"):
            Condition.parse(text).named(dataset)
    with pytest.raises(BadInputError, match="in this order: Böhm"):
        Condition.parse("1,2,3,4,5,6,7").named(dataset)


def test_a_pair_names_cameras_as_their_owners(labelled: Path) -> None:
    scene = Scene.open(labelled)
    assert scene.named_pair(("カメラ右", "left")) == ("right", "left")
    assert scene.named_pair(None) is None
    with pytest.raises(BadInputError, match="Böhm cannot be paired with itself"):
        scene.named_pair(("Böhm", "left"))


class Measured(Provenance, frozen=True, kw_only=True):
    reference: str
    cameras: tuple[str, ...]


class Looker(Method, frozen=True, kw_only=True):
    name = "look"
    help = "Look."

    def save(self, scene: Scene, condition: Condition, output: OutputFolder) -> Measured:
        return Measured(reference=condition.anchor, cameras=tuple(dict(condition.named_ms)))

    def lines(self, result: Any, out: Path) -> Iterator[str]:
        yield f"{result.reference} and {', '.join(result.cameras)}"


def test_a_method_says_labels_and_stores_names(labelled: Path, tmp_path: Path) -> None:
    command, out = method_command(Looker), tmp_path / "out"
    done = CliRunner().invoke(command, [str(labelled), "--condition", "カメラ右=9@Böhm", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert done.stdout == "Böhm and カメラ右\n"
    found = json.loads((out / "metrics.json").read_text())
    assert found["labels"] == LABELS
    assert (found["reference"], found["cameras"]) == ("left", ["right"])
