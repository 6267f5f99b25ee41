"""Profiles of devices on disk."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from capture_app.common.camera_facts import CameraFacts, PhaseControl
from capture_app.node.camera import device_profiles
from capture_app.node.camera.device_profiles import FILE, DeviceProfiles, link_key, mode_key
from capture_app.session.files.locks import lock_file
from capture_app.sync.clock.clock_filter import PathAsymmetry
from capture_app.sync.phase.actuators import InjectionProfile
from tests.facts import make_facts

PROFILE = InjectionProfile(10_840, 2, 3056.0)


def camera(model: str = "Phone", width: int = 640) -> CameraFacts:
    return make_facts(model=model, width=width, phase_control=PhaseControl.INJECTION)


def test_a_profile_is_found_again_by_model_and_mode(tmp_path: Path) -> None:
    profiles = DeviceProfiles(tmp_path / "data")
    assert profiles.read(mode_key(camera())).usable_injection is None
    assert profiles.save(mode_key(camera()), injection=PROFILE)
    assert profiles.save(mode_key(camera()), injection=PROFILE), "again changes nothing"
    again = DeviceProfiles(tmp_path / "data")
    assert again.read(mode_key(camera())).usable_injection == PROFILE
    assert again.read(mode_key(camera(model="Other"))).usable_injection is None
    assert again.read(mode_key(camera(width=1280))).usable_injection is None
    assert [path.name for path in (tmp_path / "data").iterdir()] == [FILE]


def test_a_gain_may_be_any_number_and_a_whole_one_of_before_is_read(tmp_path: Path) -> None:
    profiles = DeviceProfiles(tmp_path)
    real = InjectionProfile(10_840, 1.463, 3056.25)
    assert profiles.save(mode_key(camera()), injection=real)
    assert profiles.read(mode_key(camera())).usable_injection == real
    written = (tmp_path / FILE).read_text()
    (tmp_path / FILE).write_text(written.replace("1.463", "2"))
    assert profiles.read(mode_key(camera())).usable_injection == InjectionProfile(10_840, 2, 3056.25)
    (tmp_path / FILE).write_text(written.replace("1.463", "40"))
    assert profiles.read(mode_key(camera())).usable_injection is None


def test_a_broken_file_is_as_good_as_none(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b'{"sim/Phone": [1')
    profiles = DeviceProfiles(tmp_path)
    assert profiles.read(mode_key(camera())).usable_injection is None
    assert profiles.save(mode_key(camera()), injection=PROFILE)
    assert profiles.read(mode_key(camera())).usable_injection == PROFILE


def test_start_latencies_are_kept_beside_what_long_frames_do(tmp_path: Path) -> None:
    profiles = DeviceProfiles(tmp_path)
    assert profiles.read(mode_key(camera())).start_latencies_ns == ()
    profiles.save(mode_key(camera()), injection=PROFILE)
    assert profiles.save(mode_key(camera()), start_latencies_ns=tuple(range(100)))
    assert profiles.read(mode_key(camera())).start_latencies_ns == tuple(range(100))
    assert profiles.read(mode_key(camera())).usable_injection == PROFILE
    assert profiles.read(mode_key(camera(model="Other"))).start_latencies_ns == ()


def test_nodes_that_save_at_once_keep_each_others(tmp_path: Path) -> None:
    models = [f"Phone {number}" for number in range(40)]
    with ThreadPoolExecutor(8) as threads:
        saved = threads.map(
            lambda model: DeviceProfiles(tmp_path).save(mode_key(camera(model=model)), injection=PROFILE),
            models,
        )
        assert all(saved)
    profiles = DeviceProfiles(tmp_path)
    assert all(profiles.read(mode_key(camera(model=model))).usable_injection == PROFILE for model in models)


def test_what_another_node_saved_of_a_device_meanwhile_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    profiles, key = DeviceProfiles(tmp_path), mode_key(camera())

    def lock(path: Path, *, wait: bool) -> int:
        monkeypatch.undo()
        assert profiles.save(key, start_latencies_ns=(5,))
        return lock_file(path, wait=wait)

    monkeypatch.setattr(device_profiles, "lock_file", lock)
    assert profiles.save(key, injection=PROFILE)
    assert (profiles.read(key).injection, profiles.read(key).start_latencies_ns) == (PROFILE, (5,))


def test_a_folder_that_cannot_be_written_is_no_failure(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    assert not DeviceProfiles(tmp_path / "file").save(mode_key(camera()), injection=PROFILE)


def test_a_measured_link_is_known_by_its_camera_and_leader(tmp_path: Path) -> None:
    asymmetry = PathAsymmetry(150_000, 40_000, 1_200_000)
    profiles = DeviceProfiles(tmp_path)
    assert profiles.read(link_key("a", "192.168.1.2")).asymmetry is None
    assert profiles.save(link_key("a", "192.168.1.2"), asymmetry=asymmetry)
    again = DeviceProfiles(tmp_path)
    assert again.read(link_key("a", "192.168.1.2")).asymmetry == asymmetry
    assert again.read(link_key("b", "192.168.1.2")).asymmetry is None
    assert again.read(link_key("a", "192.168.1.3")).asymmetry is None
