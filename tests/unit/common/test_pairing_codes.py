"""Codes and pins as people type them."""

import pytest

from capture_app.common.errors import BadInputError
from capture_app.common.pairing_codes import parse_code, show_code


def test_codes_are_read_as_people_type_them() -> None:
    assert parse_code(show_code("12345678")) == parse_code(" 1234-5678\n") == "12345678"
    for text in ("", "1234567", "123456789", "1234567a", "١٢٣٤٥٦٧٨"):
        with pytest.raises(BadInputError, match="is not a code"):
            parse_code(text)
