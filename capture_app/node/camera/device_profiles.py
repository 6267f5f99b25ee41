"""Stored profiles of each device, mode and link, as JSON in the user's data folder."""

import os
from pathlib import Path
from typing import Any

import msgspec
from platformdirs import user_data_path

from capture_app.common.camera_facts import CameraFacts, StampAccuracy
from capture_app.common.text import UNREADABLE
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.locks import lock_file
from capture_app.sync.clock.clock_filter import PathAsymmetry
from capture_app.sync.phase.actuators import InjectionProfile
from capture_app.sync.phase.injection import GAIN_LIMITS

FILE = "device-profiles.json"
MAX_LATENCIES = 24


class _Entry(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    injection: InjectionProfile | None = None
    start_latencies_ns: tuple[int, ...] = ()
    stamp: StampAccuracy | None = None
    asymmetry: PathAsymmetry | None = msgspec.field(default=None, name="way")


class DeviceProfiles:
    """Stored timing profiles of camera models in one folder.

    If the file cannot be read or written, nodes only lack some corrections.
    """

    def __init__(self, folder: Path | None = None) -> None:
        """`folder` replaces the user's data folder, $XDG_DATA_HOME/simulshot on Linux."""
        self._path = (folder or user_data_path("simulshot")) / FILE

    def injection_profile(self, facts: CameraFacts) -> InjectionProfile | None:
        """Return the effect of a long frame on cameras of this kind and mode; None if unknown."""
        known = self._entry(_key(facts)).injection
        min_gain, max_gain = GAIN_LIMITS
        is_usable = known is not None and min_gain <= known.gain <= max_gain and known.row_time_ns > 0
        return known if is_usable else None

    def start_latencies_ns(self, facts: CameraFacts) -> tuple[int, ...]:
        """Return start latencies of cameras of this kind and mode, modulo the period in ns, newest last."""
        return self._entry(_key(facts)).start_latencies_ns[-MAX_LATENCIES:]

    def save_injection(self, facts: CameraFacts, profile: InjectionProfile) -> bool:
        """Store the effect of a long frame on cameras of this kind; return False if it cannot be written."""
        return self._write(_key(facts), injection=profile)

    def save_start_latencies(self, facts: CameraFacts, latencies_ns: tuple[int, ...]) -> bool:
        """Store start latencies, replacing earlier ones; return False if they cannot be written."""
        return self._write(_key(facts), start_latencies_ns=latencies_ns[-MAX_LATENCIES:])

    def stamp(self, camera: str, facts: CameraFacts) -> StampAccuracy | None:
        """Return the measured delay of this camera's timestamps; None if it was never measured."""
        return self._entry(_key_of_one(camera, facts)).stamp

    def save_stamp(self, camera: str, facts: CameraFacts, stamp: StampAccuracy) -> bool:
        """Store one camera's timestamp delay in this mode; return False if it cannot be written."""
        return self._write(_key_of_one(camera, facts), stamp=stamp)

    def asymmetry(self, camera: str, leader: str) -> PathAsymmetry | None:
        """Return the measured path asymmetry of a camera's node and the leader on that host, if any."""
        return self._entry(f"{camera}>{leader}").asymmetry

    def save_asymmetry(self, camera: str, leader: str, asymmetry: PathAsymmetry) -> bool:
        """Store the path asymmetry of such a link; return False if it cannot be written."""
        return self._write(f"{camera}>{leader}", asymmetry=asymmetry)

    def _entry(self, key: str) -> _Entry:
        return self._read().get(key, _Entry())

    def _write(self, key: str, **changes: Any) -> bool:
        known = self._entry(key)
        if msgspec.structs.replace(known, **changes) == known:
            return True
        lock_path = self._path.with_name(f"{FILE}.lock")
        try:
            # Nodes of one host share the file: two concurrent writers must not lose either's entry.
            lock = lock_file(lock_path, wait=True)
            try:
                entries = self._read() | {key: msgspec.structs.replace(self._entry(key), **changes)}
                write_atomic(self._path, msgspec.json.format(msgspec.json.encode(entries, order="sorted")))
            finally:
                lock_path.unlink(missing_ok=True)
                os.close(lock)
        except OSError:
            return False
        return True

    def _read(self) -> dict[str, _Entry]:
        try:
            return msgspec.json.decode(self._path.read_bytes(), type=dict[str, _Entry])
        except (OSError, *UNREADABLE):
            return {}


NO_PROFILES = DeviceProfiles(Path(os.devnull))
"""Profiles of nodes that store none."""


def _key(facts: CameraFacts) -> str:
    mode = f"{facts.width}x{facts.height}/{facts.period_ns}/{facts.exposure_ns or 0}"
    return f"{facts.kind}/{facts.model}/{mode}"


def _key_of_one(camera: str, facts: CameraFacts) -> str:
    """Return one camera's key, by name and mode: timestamps of two cameras of a model may differ."""
    return f"{camera}@{_key(facts)}"
