"""Names made of what people write."""

import pytest

from capture_app.common.errors import BadInputError
from capture_app.common.names import (
    check_label,
    check_name,
    folder_names,
    free_name,
    is_name,
    label_key,
    label_of,
    name_like,
)


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


def test_a_free_name_is_no_longer_than_names_may_be() -> None:
    long = "x" * 64
    assert is_name(free_name(long, [long]))


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ("Bo\u0308hm", "Böhm"),
        ("  my\u3000take ", "my take"),
        ("a=b/c\\d\te", "a-b-c-d-e"),
        ("カメラ左", "カメラ左"),
        ("👩\u200d🚀", "👩\u200d🚀"),
        ("a\udcff", "a?"),
        ("x" * 300, "x" * 255),
    ],
)
def test_a_label_is_what_was_written_in_one_form(text: str, label: str) -> None:
    assert label_of(text) == label
    assert label_of(label) == label


def test_folders_of_labels_are_told_apart_and_a_name_keeps_its_own() -> None:
    assert folder_names(["Böhm", "Bohm", "bóhm"], "camera", "cam") == ["Bohm-2", "Bohm", "bohm-3"]
    assert folder_names(["カメラ左", "nul", "右", "cam."], "camera", "cam") == ["cam0", "nul_", "cam2", "cam"]
    # What can be a folder stays as it is.
    assert folder_names(["cam-", "x" * 64], "camera", "cam") == ["cam-", "x" * 64]


@pytest.mark.parametrize("labels", [("a", "A"), ("Böhm", "BO\u0308HM"), ("ﬁlm", "film"), ("x", "x")])
def test_labels_that_a_system_takes_for_one_are_refused(labels: tuple[str, str]) -> None:
    assert label_key(labels[0]) == label_key(labels[1])
    with pytest.raises(BadInputError, match=f"two cameras are named {labels[0]}"):
        folder_names(labels, "camera", "cam")


@pytest.mark.parametrize("text", ["", " ", "a/b", "a=b", "a\nb", "\\"])
def test_a_text_that_is_no_label_is_refused(text: str) -> None:
    with pytest.raises(BadInputError, match="is not a valid name for a session"):
        check_label(text, "session")
