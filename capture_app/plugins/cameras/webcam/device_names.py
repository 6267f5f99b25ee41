"""Names of the cameras of this machine, by the numbers under which OpenCV opens them.

OpenCV reports no names. It numbers cameras in the order of each system's own list (`modules/videoio/src` of
OpenCV 5.0), so the same lists are read here.
"""

import ctypes
import json
import subprocess
import sys
from pathlib import Path
from typing import Any, cast
from uuid import UUID

_DEVICE_ENUMERATOR, _DEVICE_LISTS, _VIDEO_INPUTS, _PROPERTY_BAG = (
    UUID(identifier).bytes_le
    for identifier in (
        "62be5d10-60eb-11d0-bd3b-00a0c911ce86",
        "29840822-5b84-11d0-bd3b-00a0c911ce86",
        "860bb310-5d01-11d0-bd3b-00a0c911ce86",
        "55272a00-42cb-11ce-8135-00aa004bb851",
    )
)
"""CLSID_SystemDeviceEnum, IID_ICreateDevEnum, CLSID_VideoInputDeviceCategory, IID_IPropertyBag (uuids.h)."""
_RELEASE, _FIRST, _BIND_TO_STORAGE = 2, 3, 9
"""Places of methods in a COM object's table, after the inherited interfaces' (objidl.h)."""


def camera_names() -> dict[int, str]:
    """Return this machine's cameras by their numbers; empty on a system without a known list.

    Raises OSError, ValueError or subprocess.SubprocessError if the system's list cannot be read.
    """
    lists = {"win32": directshow_names, "darwin": avfoundation_names, "linux": video4linux_names}
    return lists.get(sys.platform, dict)()


def video4linux_names(folder: Path = Path("/sys/class/video4linux")) -> dict[int, str]:
    """Return the names of Linux's capture devices; the number is N of /dev/videoN.

    A camera's further nodes, for metadata, have an `index` above 0 (ABI/testing/sysfs-class-video4linux).
    """
    nodes = [node for node in folder.glob("video*") if (node / "index").read_text().strip() == "0"]
    return dict(sorted((int(node.name[5:]), (node / "name").read_text().strip()) for node in nodes))


def avfoundation_names() -> dict[int, str]:
    """Return the names of macOS's cameras in the order of their unique ids, like cap_avfoundation_mac.mm."""
    done = subprocess.run(
        ("/usr/sbin/system_profiler", "-json", "SPCameraDataType"),
        capture_output=True,
        timeout=10.0,
        check=True,
    )
    cameras = json.loads(done.stdout).get("SPCameraDataType", [])
    cameras.sort(key=lambda camera: str(camera.get("spcamera_unique-id")))
    return dict(enumerate(str(camera.get("_name")) for camera in cameras))


def directshow_names() -> dict[int, str]:
    """Return the names of Windows's cameras in the order of the system device enumerator, like cap_dshow.cpp.

    Source: "Using the System Device Enumerator" in Microsoft's documentation of DirectShow.
    """
    windows = cast(Any, ctypes).windll
    lists, cameras, camera = ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_void_p()
    windows.ole32.CoInitializeEx(None, 0)
    windows.ole32.CoCreateInstance(_DEVICE_ENUMERATOR, None, 1, _DEVICE_LISTS, ctypes.byref(lists))
    _call(lists, _FIRST, _VIDEO_INPUTS, ctypes.byref(cameras), 0)
    names: list[str] = []
    while _call(cameras, _FIRST, 1, ctypes.byref(camera), None) == 0:
        # A VARIANT of 64-bit Windows has 24 bytes, and its value begins after 8.
        properties, value = ctypes.c_void_p(), ctypes.create_string_buffer(24)
        _call(camera, _BIND_TO_STORAGE, None, None, _PROPERTY_BAG, ctypes.byref(properties))
        _call(properties, _FIRST, ctypes.c_wchar_p("FriendlyName"), value, None)
        names.append(ctypes.c_wchar_p.from_buffer(value, 8).value or "")
        windows.oleaut32.VariantClear(value)
        _call(properties, _RELEASE)
        _call(camera, _RELEASE)
    _call(cameras, _RELEASE)
    _call(lists, _RELEASE)
    return dict(enumerate(names))


def _call(target: ctypes.c_void_p, method: int, *arguments: Any) -> int:
    """Call a COM object's method by its place in the table; return its HRESULT, -1 if there is no object."""
    table = ctypes.cast(target, ctypes.POINTER(ctypes.POINTER(ctypes.c_void_p)))
    # On 64-bit Windows all functions have one calling convention.
    return ctypes.CFUNCTYPE(ctypes.c_long)(table[0][method] or 0)(target, *arguments) if target else -1
