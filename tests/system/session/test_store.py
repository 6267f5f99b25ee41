"""Sessions are written whole, read back as written, and never believed without a check."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.common.errors import BadInputError
from capture_app.common.names import is_name
from capture_app.session.format.manifest import inside


@given(st.text(max_size=80))
def test_no_path_leads_out(tmp_path_factory: pytest.TempPathFactory, path: str) -> None:
    folder = tmp_path_factory.getbasetemp()
    try:
        file = inside(folder, path)
    except BadInputError:
        return
    assert file.resolve().is_relative_to(folder.resolve())
    assert not is_name(path) or file.parent == folder
