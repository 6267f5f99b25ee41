"""What injections have shown about each device model and mode, kept as JSON in the user's data folder."""

import os
from pathlib import Path

import msgspec

from capture_app.cameras.base import CameraInfo
from capture_app.sync.injection import InjectionProfile

FILE = "injection-profiles.json"


class _Entry(msgspec.Struct, frozen=True, kw_only=True):
    row_time_ns: int
    gain: int
    neutral_rows: float


def data_folder() -> Path:
    """The user's data folder of this project: in $XDG_DATA_HOME, else in ~/.local/share."""
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share") / "simulshot"


class DeviceProfiles:
    """The profiles in one folder; a file that cannot be read or written only costs an injection."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE

    def find(self, info: CameraInfo) -> InjectionProfile | None:
        """The profile of cameras like this one; None where it is not known."""
        entry = self._read().get(_key(info))
        if entry is None or entry.gain not in (1, 2, 3) or entry.row_time_ns <= 0:
            return None
        return InjectionProfile(entry.row_time_ns, entry.gain, entry.neutral_rows)

    def keep(self, info: CameraInfo, profile: InjectionProfile) -> bool:
        """Keep a profile for cameras like this one; False where it cannot be written."""
        entries = self._read()
        entry = _Entry(row_time_ns=profile.row_time_ns, gain=profile.gain, neutral_rows=profile.neutral_rows)
        if entries.get(_key(info)) == entry:
            return True
        entries[_key(info)] = entry
        part = self._path.with_name(f"{FILE}.{os.getpid()}.part")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(msgspec.json.format(msgspec.json.encode(entries, order="sorted")))
            part.replace(self._path)
        except OSError:
            return False
        return True

    def _read(self) -> dict[str, _Entry]:
        try:
            return msgspec.json.decode(self._path.read_bytes(), type=dict[str, _Entry])
        except (OSError, msgspec.DecodeError, UnicodeDecodeError):
            return {}


def _key(info: CameraInfo) -> str:
    exposure_ns = info.exposure_ns or 0
    return f"{info.kind}/{info.model}/{info.width}x{info.height}/{info.period_ns}/{exposure_ns}"
