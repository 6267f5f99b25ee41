"""Values grouped by a key keep their order."""

from capture_app.common.grouping import grouped


def test_order_of_keys_and_values() -> None:
    assert [*grouped([("b", 1), ("a", 2), ("b", 3)]).items()] == [("b", [1, 3]), ("a", [2])]
    assert grouped([]) == {}
