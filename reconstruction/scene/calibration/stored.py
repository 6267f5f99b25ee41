"""Calibrations of rigs, stored in the user's data folder and found by cameras and modes.

A session without a calibration uses the stored one of its rig, if that is still valid.
"""

import hashlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import msgspec
from platformdirs import user_data_path

from capture_app.common.camera_facts import CameraFacts
from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.common.text import pretty_json
from capture_app.console.terminal import talk
from capture_app.session.files.durable import write_atomic
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.calibration_judge import camera_fault
from capture_app.session.format.manifest import MANIFEST
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View
from reconstruction.scene.calibration.consistency import (
    CalibrationCheck,
    check_rig,
    find_mixups,
    plainly_fits,
)
from reconstruction.scene.calibration.soundness import (
    calibrated_views,
    refuse_faults,
    sound_views,
)
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.features_at_rest import SceneFeatures
from reconstruction.scene.pairs import Features, detect_features


class CameraMode(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Model and mode of a camera; a stored calibration is valid for this mode only."""

    kind: str
    model: str
    width: int
    height: int

    @classmethod
    def of(cls, facts: CameraFacts) -> "CameraMode":
        """Return the mode of a camera with these properties."""
        return cls(kind=facts.kind, model=facts.model, width=facts.width, height=facts.height)


class StoredCalibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A stored calibration with its cameras' modes and the session it was made for."""

    modes: dict[str, CameraMode]
    session: str
    created: str
    """When that session was taken, RFC 3339, UTC."""
    calibration: Calibration
    schema_version: int = 1

    @property
    def with_origin(self) -> Calibration:
        """The calibration, with the session that it comes from in its source."""
        source = f"{self.calibration.source or 'unknown'}, kept from {self.session} of {self.created[:10]}"
        return msgspec.structs.replace(self.calibration, source=source)


def shelf() -> Path:
    """Return the folder of stored calibrations, one file each; in $XDG_DATA_HOME/simulshot on Linux."""
    return user_data_path("simulshot") / "calibrations"


def keep_calibration(dataset: Dataset, calibration: Calibration) -> None:
    """Store a session's calibration in place of any earlier one of these cameras.

    Raises:
        BadInputError: it has no scale and would replace one in metres, or cannot be written.
    """
    modes = {name: mode for name, mode in camera_modes(dataset).items() if name in calibration.cameras}
    key = hashlib.sha256(msgspec.json.encode(dict(sorted(modes.items())))).hexdigest()[:12]
    path = shelf() / f"{len(modes)}-cameras-{key}.json"
    if (known := _read(path)) is not None and calibration.unit == "arbitrary" != known.calibration.unit:
        raise BadInputError(
            f"the one kept from {known.session} is in metres, and this one has no scale",
            hint="--mark and --distance-m set it, or --scale-by-board",
        )
    write_calibration(
        path,
        StoredCalibration(
            modes=modes,
            session=dataset.name,
            created=dataset.session.manifest.created,
            calibration=calibration,
        ),
    )


def find_calibration(modes: Mapping[str, CameraMode]) -> StoredCalibration | None:
    """Return the stored calibration that fits the most of these cameras: at least two, and half of all.

    A camera fits if it has the mode in which it was calibrated. Of equals, the newest calibration is
    returned. Files that cannot be read are ignored.
    """
    known = [
        (sum(entry.modes.get(name) == mode for name, mode in modes.items()), entry)
        for path in sorted(shelf().glob("*.json"))
        if (entry := _read(path)) is not None
    ]
    fitting, stored = max(
        known,
        key=lambda candidate: (candidate[0], candidate[1].created, candidate[1].session),
        default=(0, None),
    )
    if stored is None or fitting < max(2, (len(modes) + 1) // 2):
        return None
    return msgspec.structs.replace(stored, calibration=_in_same_mode(stored.calibration, stored.modes, modes))


def find_rig_views(modes: Mapping[str, CameraMode], folder: Path | None) -> tuple[dict[str, View], str]:
    """Return the calibrated views of a running rig's cameras, and their unit; empty if none is known.

    By a new session in `folder` that has a calibration of two of these cameras, else by the stored one.
    """
    sessions = [] if folder is None else sorted(folder.glob(f"*/{MANIFEST}"), key=lambda p: p.stat().st_mtime)
    calibrations: list[Calibration] = []
    for path in reversed(sessions[-10:]):
        with suppress(SimulshotError):
            dataset = Dataset(Session.open(path.parent))
            if (own := dataset.session.calibration()) is not None:
                calibrations.append(_in_same_mode(own, camera_modes(dataset), modes))
    if (stored := find_calibration(modes)) is not None:
        calibrations.append(stored.calibration)
    chosen = next((one for one in calibrations if len(one.cameras) > 1), None)
    if chosen is None:
        return {}, ""
    views = {
        name: View.from_calibration(camera, modes[name].width, modes[name].height)
        for name, camera in chosen.cameras.items()
        if not camera_fault(camera)
    }
    return views, chosen.unit


def _in_same_mode(
    calibration: Calibration, before: Mapping[str, CameraMode], now: Mapping[str, CameraMode]
) -> Calibration:
    """Return a calibration without the cameras whose mode has changed."""
    same = {
        name: camera
        for name, camera in calibration.cameras.items()
        if name in now and before.get(name) == now[name]
    }
    return msgspec.structs.replace(calibration, cameras=same)


def write_calibration(path: Path, calibration: Calibration | StoredCalibration) -> None:
    """Write a calibration's file, creating its folder if necessary.

    Raises:
        BadInputError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, pretty_json(calibration))
    except OSError as error:
        raise BadInputError(
            f"cannot write {path}: {error.strerror or error}",
            hint="make room and allow writing there, then repeat the command",
        ) from error


def camera_modes(dataset: Dataset) -> dict[str, CameraMode]:
    """Return the mode of each of a session's cameras."""
    return {camera.name: CameraMode.of(camera.facts) for camera in dataset.session.manifest.cameras}


def _read(path: Path) -> StoredCalibration | None:
    try:
        return msgspec.json.decode(path.read_bytes(), type=StoredCalibration)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        return None


def known_calibration(dataset: Dataset) -> Calibration | None:
    """Return a session's own calibration or its rig's stored one, unchecked; imports adopt none."""
    if (own := dataset.session.calibration()) is not None:
        return own
    is_imported = dataset.session.manifest.origin == "imported"
    stored = None if is_imported else find_calibration(camera_modes(dataset))
    return None if stored is None else stored.calibration


def choose_calibration(features: SceneFeatures) -> Calibration | None:
    """Return a session's own calibration, checked against its images, or its rig's stored one, and say so.

    `features` are the session's.

    Single cameras whose calibration cannot be right are left out, by name, if two or more others remain.

    Imported recordings do not identify a rig and adopt none.

    Raises:
        BadInputError: its own calibration does not fit its images; the message lists all faults.
    """
    dataset = features.dataset
    if (own := dataset.session.calibration()) is not None:
        own = dataset.straight_calibration(own)
        views, faults = sound_views(dataset, own)
        # By 500 points of reduced images, for a first, quick check.
        if not plainly_fits(views, _middle_features(dataset, views, 320, 500)):
            faults += find_mixups(views, _middle_features(dataset, views))
        good = {name: own.cameras[name] for name in views if name not in dict(faults)}
        refuse_faults(dataset, good, faults)
        if not faults:
            return own
        left_out = [f"{name} is left out: {text}" for name, text in dict(reversed(faults)).items()]
        talk("\n".join(reversed(left_out)))
        return msgspec.structs.replace(own, cameras=good)
    is_imported = dataset.session.manifest.origin == "imported"
    if is_imported or (stored := find_calibration(camera_modes(dataset))) is None:
        return None
    calibration = dataset.straight_calibration(stored.calibration)
    stored = msgspec.structs.replace(stored, calibration=calibration)
    try:
        views = calibrated_views(dataset, calibration)
        check = check_rig(views, features.middle, calibration.known_lenses)
        why = "" if check.holds else f"{check} (calibrate the rig again: reconstruct calibrate)"
    except BadInputError as error:
        why = error.what
    if why:
        talk(f"the calibration kept from {stored.session} is not used: {why}")
        return None
    talk(f"calibration kept from {stored.session} of {stored.created[:10]}: {describe_check(check)}")
    return stored.with_origin


def _middle_features(dataset: Dataset, cameras: Iterable[str], *detection: int) -> dict[str, Features]:
    """Return by camera the features of its middle image, if that can be read."""
    shelves = {}
    for name in cameras:
        if there := dataset.instants(name):
            with suppress(BadInputError):
                shelves[name] = detect_features(dataset.grey(name, there[len(there) // 2]), *detection)
    return shelves


def describe_check(check: CalibrationCheck) -> str:
    """Describe the result of a check."""
    if check.error_px is None:
        return "it cannot be checked: the cameras share too few static points"
    unchecked = f"; not checked: {', '.join(check.unchecked)}" if check.unchecked else ""
    return f"{check} (points at rest fit within {check.error_px:.1f} px){unchecked}"
