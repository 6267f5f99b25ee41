"""Folders of recordings as strangers have them, beside those that tests/system tries."""

from pathlib import Path

import pytest

from tests.system.companions.importing.test_folders_of_strangers import OFTEN, import_folder
from tests.unit.companions.importing.strangers import FOLDERS


@pytest.mark.parametrize("name", sorted({*FOLDERS} - {*OFTEN}))
def test_one_command_without_an_option(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import_folder(name, tmp_path, capsys)
