"""Names made of what people write."""

import pytest

from capture_app.common.names import name_like


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
