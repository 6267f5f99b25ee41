"""The score of an import is read from the stored pixels: it sees wrong pairs, cameras and names."""

from benchmarks.sessions.drawn_folders import Folder, Picture, Shot
from benchmarks.sessions.folder_layouts import RIGHT, import_folder

NAMES = (("left",), ("right",))


def pair_folder(*right_shots: Shot, names: tuple[tuple[str, ...], ...] = NAMES) -> Folder:
    """Two cameras' folders, of which the right one's pictures show other shots than its names say."""
    left = [Picture(f"left/{n}.png", Shot(0, n)) for n in range(len(right_shots))]
    right = [Picture(f"right/{n}.png", shot) for n, shot in enumerate(right_shots)]
    return Folder(names, (*left, *right), answers={"fps": "30"})


def test_pictures_that_show_their_names_instants_are_right() -> None:
    assert import_folder(pair_folder(Shot(1, 0), Shot(1, 1))).verdict in RIGHT


def test_pictures_of_other_instants_are_a_false_pair() -> None:
    outcome = import_folder(pair_folder(Shot(1, 1), Shot(1, 0)))
    assert outcome.verdict in {"false pair", "misled"}
    assert "instant 0" in outcome.detail


def test_a_camera_that_shows_itself_twice_is_no_second_camera() -> None:
    assert import_folder(pair_folder(Shot(0, 0), Shot(0, 1))).verdict == "cameras"


def test_another_name_than_the_owners_is_a_fault_of_its_own() -> None:
    outcome = import_folder(pair_folder(Shot(1, 0), Shot(1, 1), names=(("Böhm",), ("Müller",))))
    assert (outcome.verdict, "Böhm is left" in outcome.detail) == ("names", True)
