"""Each kind of file of an export, spoiled in each way, in the formats that tests/system does not try."""

from pathlib import Path

import pytest

from tests.system.companions.importing.test_spoiled_files import (
    EXPORTS,
    IN_SYSTEM,
    PHONES,
    check_export,
    sound,  # noqa: F401 - a fixture
)


@pytest.mark.timeout(900)
@pytest.mark.parametrize("export", sorted({*EXPORTS, *PHONES} - {*IN_SYSTEM}))
def test_an_export_with_a_spoiled_file_is_imported_or_refused_with_a_remedy(
    export: str, sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check_export(export, sound, tmp_path, capsys)
