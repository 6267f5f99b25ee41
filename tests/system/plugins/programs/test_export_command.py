"""`capture-app sessions export`: bad sessions and bad places give one clear line and leave nothing."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import pytest

from capture_app.common.errors import ExitCode
from capture_app.common.plugins import plugin_names
from capture_app.session.exporting import exported_burst
from capture_app.session.exporting.exporter import GROUP
from capture_app.session.format.manifest import image_path
from capture_app.session.reading.decoding import Size, decode_image, size_of
from tests.unit.plugins.programs.conftest import Make, encode, picture
from tests.unit.plugins.programs.test_export_command import refuses  # noqa: F401 - a fixture
from tests.unit.session.conftest import edit_manifest

HERE = sorted({*plugin_names(GROUP)} - {"rrd", *(() if find_spec("opentimelineio") else ("otio",))})


@pytest.mark.parametrize("name", HERE)
def test_missing_and_changed_images(make: Make, refuses: Callable[..., None], name: str) -> None:
    session = make()
    file = session.folder / image_path("left", 3)
    file.rename(file.with_name("renamed.jpg"))
    refuses(session.folder, ExitCode.INCOMPLETE, "left/000003.jpg is missing", name)
    file.write_bytes(encode(picture("left", 2)))
    refuses(session.folder, ExitCode.BAD_INPUT, "not the image that was saved", name)


@pytest.mark.parametrize("name", HERE)
def test_images_that_lie_about_themselves(
    make: Make, refuses: Callable[..., None], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their headers suffice: one of 16384x16384 px took 1.6 GB before it was refused."""
    decoded: list[Size | None] = []

    def noted(data: bytes, **options: Any) -> Any:
        decoded.append(size_of(data))
        return decode_image(data, **options)

    monkeypatch.setattr(exported_burst, "decode_image", noted)
    session = make(sizes={"right": (80, 64)}, missing=(), substitutes={})

    def claim(content: dict[str, Any]) -> None:
        for camera in content["cameras"]:
            camera["facts"]["width"] = 96

    edit_manifest(session, claim)
    calibration = session.folder / "calibration.json"
    calibration.write_text(calibration.read_text().replace('"width": 80', '"width": 96'))
    refuses(session.folder, ExitCode.BAD_INPUT, "is 80x64 pixels; right takes 96x64", name)
    assert (80, 64) not in decoded
