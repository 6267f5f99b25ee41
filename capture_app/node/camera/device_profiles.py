"""Stored profiles of each device, mode and link, as JSON in the user's data folder."""

import os
from pathlib import Path
from typing import Any

import msgspec
from platformdirs import user_data_path

from capture_app.common.address import Address
from capture_app.common.camera_facts import CameraFacts, StampAccuracy
from capture_app.common.text import UNREADABLE
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.locks import lock_file
from capture_app.sync.clock.clock_filter import PathAsymmetry
from capture_app.sync.phase.actuators import InjectionProfile
from capture_app.sync.phase.injection import GAIN_LIMITS

FILE = "device-profiles.json"


class DeviceProfile(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What is known of a camera's mode, of one camera in a mode, of the link to a leader, or of a node."""

    injection: InjectionProfile | None = None
    """Effect of a long frame, in one mode of a kind of camera."""
    start_latencies_ns: tuple[int, ...] = ()
    """Start latencies modulo the period in ns, in one mode of a kind of camera, newest last."""
    stamp: StampAccuracy | None = None
    """Measured delay of one camera's timestamps."""
    asymmetry: PathAsymmetry | None = msgspec.field(default=None, name="way")
    """Measured path asymmetry of a link."""
    followed: dict[str, tuple[Address, ...]] = msgspec.field(default_factory=dict)
    """Addresses of each leader that a node followed, by the leader's key; both newest last."""

    @property
    def usable_injection(self) -> InjectionProfile | None:
        """Effect of a long frame if it is plausible, else None."""
        known, (min_gain, max_gain) = self.injection, GAIN_LIMITS
        is_usable = known is not None and min_gain <= known.gain <= max_gain and known.row_time_ns > 0
        return known if is_usable else None


class DeviceProfiles:
    """Stored timing profiles of camera models in one folder.

    If the file cannot be read or written, nodes only lack some corrections.
    """

    def __init__(self, folder: Path | None = None) -> None:
        """`folder` replaces the user's data folder, $XDG_DATA_HOME/simulshot on Linux."""
        self._path = (folder or user_data_path("simulshot")) / FILE

    def read(self, key: str) -> DeviceProfile:
        """Return what is known of a mode, a camera or a link, by its key."""
        return self._read_all().get(key, DeviceProfile())

    def save(self, key: str, **changes: Any) -> bool:
        """Change these fields of a mode's, a camera's or a link's profile; return False if that fails."""
        known = self.read(key)
        # The order counts, too: the leader that was followed last.
        if msgspec.json.encode(msgspec.structs.replace(known, **changes)) == msgspec.json.encode(known):
            return True
        lock_path = self._path.with_name(f"{FILE}.lock")
        try:
            # Nodes of one host share the file: two concurrent writers must not lose either's entry.
            lock = lock_file(lock_path, wait=True)
            try:
                entries = self._read_all() | {key: msgspec.structs.replace(self.read(key), **changes)}
                write_atomic(self._path, msgspec.json.format(msgspec.json.encode(entries)))
            finally:
                lock_path.unlink(missing_ok=True)
                os.close(lock)
        except OSError:
            return False
        return True

    def _read_all(self) -> dict[str, DeviceProfile]:
        try:
            return msgspec.json.decode(self._path.read_bytes(), type=dict[str, DeviceProfile])
        except (OSError, *UNREADABLE):
            return {}


NO_PROFILES = DeviceProfiles(Path(os.devnull))
"""Profiles of nodes that store none."""


def mode_key(facts: CameraFacts) -> str:
    """Return the key of the profile of all cameras of this kind and mode."""
    mode = f"{facts.width}x{facts.height}/{facts.period_ns}/{facts.exposure_ns or 0}"
    return f"{facts.kind}/{facts.model}/{mode}"


def camera_key(camera: str, facts: CameraFacts) -> str:
    """Return the key of one camera's profile in a mode: timestamps of two cameras of a model may differ."""
    return f"{camera}@{mode_key(facts)}"


def link_key(camera: str, leader: str) -> str:
    """Return the key of the profile of the link between a camera's node and the leader on that host."""
    return f"{camera}>{leader}"


def node_key(name: str) -> str:
    """Return the key of the profile of a node."""
    return f"{name}>"
