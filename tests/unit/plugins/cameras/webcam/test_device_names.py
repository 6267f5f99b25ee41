"""Names of cameras from each system's list: files, a report, and COM objects as DirectShow documents them."""

import ctypes
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from uuid import UUID

import pytest

from capture_app.plugins.cameras.webcam import device_names


def test_linux_names_capture_devices_and_not_their_metadata(tmp_path: Path) -> None:
    for node, name, index in (("video10", "Other", 0), ("video0", "LabCam", 0), ("video1", "LabCam", 1)):
        (tmp_path / node).mkdir()
        (tmp_path / node / "name").write_text(f"{name}\n")
        (tmp_path / node / "index").write_text(f"{index}\n")
    assert list(device_names.video4linux_names(tmp_path).items()) == [(0, "LabCam"), (10, "Other")]


def test_macos_counts_cameras_by_their_unique_ids(monkeypatch: pytest.MonkeyPatch) -> None:
    report = {
        "SPCameraDataType": [
            {"_name": "FaceTime HD Camera", "spcamera_unique-id": "3F45E80A-0176-46F7-B185-BB9E2C0E82E3"},
            {"_name": "Logi C310", "spcamera_unique-id": "0x110000046d081b"},
        ]
    }
    done = SimpleNamespace(stdout=json.dumps(report).encode())
    monkeypatch.setattr(subprocess, "run", lambda command, **_: done)
    monkeypatch.setattr(sys, "platform", "darwin")
    assert device_names.camera_names() == {0: "Logi C310", 1: "FaceTime HD Camera"}


def test_a_system_without_a_list_has_no_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "freebsd14")
    assert device_names.camera_names() == {}


NUMBER = ctypes.c_void_p
PLACE = ctypes.POINTER(NUMBER)


def guid(address: int) -> UUID:
    return UUID(bytes_le=ctypes.string_at(address, 16))


class FakeDirectShow:
    """`ctypes.windll` with the system device enumerator, whose objects count their references."""

    def __init__(self, *cameras: str | None) -> None:
        """None is a camera whose properties cannot be read."""
        self.waiting, self.held, self.cleared = list(cameras), 0, 0
        self._alive: list[Any] = []
        self.ole32 = SimpleNamespace(CoInitializeEx=lambda _, how: 0, CoCreateInstance=self.create)
        self.oleaut32 = SimpleNamespace(VariantClear=self.clear)

    def create(self, kind: bytes, outer: None, context: int, interface: bytes, result: Any) -> int:
        assert UUID(bytes_le=kind) == UUID("62be5d10-60eb-11d0-bd3b-00a0c911ce86")
        assert UUID(bytes_le=interface) == UUID("29840822-5b84-11d0-bd3b-00a0c911ce86")
        result._obj.value = self.thing(3, 4, self.list_devices)
        return 0

    def list_devices(self, this: int, category: int, result: int, flags: int | None) -> int:
        assert guid(category) == UUID("860bb310-5d01-11d0-bd3b-00a0c911ce86")
        if not self.waiting:
            return 1  # S_FALSE: the category is empty, and there is no enumerator
        ctypes.cast(result, PLACE)[0] = self.thing(3, 4, self.next)
        return 0

    def next(self, this: int, count: int, result: int, fetched: int | None) -> int:
        if not self.waiting:
            return 1
        name = self.waiting.pop(0)

        def bind(this: int, context: None, left: None, interface: int, bag: int) -> int:
            assert guid(interface) == UUID("55272a00-42cb-11ce-8135-00aa004bb851")
            if name is None:
                return -0x7FFFBFFB  # E_FAIL
            ctypes.cast(bag, PLACE)[0] = self.thing(3, 4, lambda *given: self.read(name, *given))
            return 0

        ctypes.cast(result, PLACE)[0] = self.thing(9, 5, bind)
        return 0

    def read(self, name: str, this: int, key: int, variant: int, log: None) -> int:
        assert ctypes.wstring_at(key) == "FriendlyName"
        text = ctypes.create_unicode_buffer(name)
        self._alive.append(text)
        ctypes.c_uint16.from_address(variant).value = 8  # VT_BSTR
        NUMBER.from_address(variant + 8).value = ctypes.addressof(text)
        return 0

    def clear(self, variant: Any) -> int:
        self.cleared += 1
        return 0

    def release(self, this: int) -> int:
        self.held -= 1
        return 0

    def thing(self, place: int, arguments: int, method: Callable[..., int]) -> int:
        """A COM object with one method besides Release; it lives as long as this."""
        self.held += 1
        table = (NUMBER * 10)()
        for at, count, function in ((2, 1, self.release), (place, arguments, method)):
            called = ctypes.CFUNCTYPE(ctypes.c_long, *(NUMBER,) * count)(function)
            self._alive.append(called)
            table[at] = ctypes.cast(called, NUMBER).value
        this = (PLACE * 1)(ctypes.cast(table, PLACE))
        self._alive += [table, this]
        return ctypes.addressof(this)


@pytest.mark.parametrize(
    ("cameras", "names"),
    [
        (("HD Pro Webcam C920", "Kamera für Büro"), {0: "HD Pro Webcam C920", 1: "Kamera für Büro"}),
        (("One", None, "Three"), {0: "One", 1: "", 2: "Three"}),
        ((), {}),
    ],
)
def test_windows_counts_cameras_as_directshow_lists_them(
    monkeypatch: pytest.MonkeyPatch, cameras: tuple[str | None, ...], names: dict[int, str]
) -> None:
    windows = FakeDirectShow(*cameras)
    monkeypatch.setattr(ctypes, "windll", windows, raising=False)
    monkeypatch.setattr(sys, "platform", "win32")
    assert device_names.camera_names() == names
    assert (windows.held, windows.cleared) == (0, len(cameras)), "every object is released"
