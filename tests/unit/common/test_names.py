"""Names made of what people write."""

import pytest

from capture_app.common.errors import BadInputError
from capture_app.common.names import check_name, free_name, is_name, name_like


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Kamera größe", "Kamera-grosse"),
        ("Été é", "Ete-e"),
        ("カメラ", "cam0"),
        ("links!", "links"),
        ("a b", "a-b"),
    ],
)
def test_the_nearest_name_keeps_letters_without_their_accents(text: str, name: str) -> None:
    assert name_like(text, "cam0") == name


@pytest.mark.parametrize(
    ("text", "name"),
    [("con", "con_"), ("NUL", "NUL_"), ("aux.1", "aux_.1"), ("cam.", "cam"), ("com10", "com10")],
)
def test_a_name_of_a_windows_device_gets_another(text: str, name: str) -> None:
    assert check_name(name_like(text, "cam0"), "camera") == name


@pytest.mark.parametrize("name", ["con", "CON", "nul", "aux.1", "Com1", "lpt9.x", "cam."])
def test_what_is_no_folder_on_windows_is_refused_everywhere_but_still_read(name: str) -> None:
    with pytest.raises(BadInputError, match="is not a valid name"):
        check_name(name, "camera")
    assert is_name(name)


@pytest.mark.parametrize("name", ["console", "cam.1", "auxiliary", "nul-1", "com", "lpt"])
def test_names_that_only_begin_like_a_device_are_valid(name: str) -> None:
    assert check_name(name, "camera") == name


def test_a_free_name_differs_by_more_than_case() -> None:
    assert free_name("Cam", ["cam", "CAM-2"]) == "Cam-3"
