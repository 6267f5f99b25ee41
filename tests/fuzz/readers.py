"""What the fuzzer feeds: each reader takes any bytes, and raises what users are told of or nothing.

A reader of files is given a folder of its own, in which it may write what it likes.
"""

import asyncio
import io
import random
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from capture_app.camera_facts import CameraFacts
from capture_app.errors import SimulshotError
from capture_app.net.address import Address
from capture_app.net.channel import Channel
from capture_app.node.camera.device_profiles import DeviceProfiles
from capture_app.node.transfer.spool import SpooledBurst
from capture_app.node.wire import messages
from capture_app.session.exporters.export_session import export_session
from capture_app.session.format.burst_plan import PLAN, BurstPlan, CameraPlan, read_plan
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.ground_truth import TIMES, ground_truth_path
from capture_app.session.format.manifest import CALIBRATION, JOURNAL, MANIFEST
from capture_app.session.importers.calibrations.reading import read_views
from capture_app.session.importers.open_sources import open_sources
from capture_app.session.importers.rate_or_table import timeline_by_table
from capture_app.session.importers.recording import ImportOptions, import_recording
from capture_app.session.reading.checksums import CHECKSUMS
from capture_app.session.reading.decoding import decode_image
from capture_app.session.reading.exif import read_exif
from capture_app.session.reading.picture_size import size_of
from capture_app.session.reading.reader import Session, list_sessions
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.session.reading.verdict import judge
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.wire.codec import WireError, decode, encode
from capture_app.trust.keys import LeaderKeys
from capture_app.trust.known_machines import FILE, KnownMachines, Role
from capture_app.trust.pairing import InvitationDesk
from capture_app.trust.sealed_engines import SealedLeader
from capture_app.trust.sealing import SealError
from reconstruction.session.dataset import Dataset
from tests.facts import make_facts
from tests.session.conftest import calibration_of, fill, jpeg

Reader = Callable[[bytes, Path], None]


def read_datagram(data: bytes, folder: Path) -> None:
    """What is taken for a message is one: it can be sent on, and comes out the same."""
    with suppress(WireError):
        message = decode(data)
        assert decode(encode(message)) == message


def read_stream(expected: Any) -> Reader:
    """A transfer stream's reader of the messages that one side expects."""
    decoder = msgspec.json.Decoder(expected)

    def read(data: bytes, folder: Path) -> None:
        async def take() -> None:
            reader = asyncio.StreamReader()
            reader.feed_data(data)
            reader.feed_eof()
            channel: Channel[Any] = Channel(reader, _NoWriter(), decoder)  # type: ignore[arg-type]
            while await channel.receive() is not None:
                pass

        with suppress(SimulshotError):
            asyncio.run(take())

    return read


class _NoWriter:
    """The writing end of a stream that is only read."""

    def get_extra_info(self, _: str) -> Any:
        return ("192.0.2.1", 1)


def read_session_file(name: str) -> Reader:
    """A session in which one file is whatever a stranger made of it: listed, opened, verified, shown."""

    def read(data: bytes, folder: Path) -> None:
        session = _session(folder)
        _put(session / name, data)
        list_sessions(folder)
        with suppress(SimulshotError):
            opened = Session.open(session)
            verify(opened)
            judge(opened.manifest)
            opened.calibration()
            opened.true_times()
        for use in (TakeSheet.open, Dataset.open, read_plan):
            with suppress(SimulshotError):
                use(session)

    return read


def read_ground_truth(data: bytes, folder: Path) -> None:
    """The true depth of an image."""
    session = _session(folder)
    _put(session / ground_truth_path("left", 0), data)
    with suppress(SimulshotError):
        Dataset.open(session).ground_truth("left", 0)


def repair_session(data: bytes, folder: Path) -> None:
    """An unfinished session whose journal is broken: what is whole is kept."""
    session = _session(folder)
    (session / MANIFEST).unlink()
    _put(session / JOURNAL, data)
    with suppress(SimulshotError):
        SessionWriter.resume(session).abort()
    assert len(list(session.rglob("*.jpg"))) == 5


def read_spool(data: bytes, folder: Path) -> None:
    """A burst that a node still has to send."""
    (folder / "report.json").write_bytes(data)
    (folder / JOURNAL).write_bytes(data)
    burst = SpooledBurst(folder)
    with suppress(SimulshotError):
        burst.read_report()
    with suppress(SimulshotError):
        list(burst.read_images())


def read_profiles(data: bytes, folder: Path) -> None:
    """What this machine knows of its devices."""
    (folder / "device-profiles.json").write_bytes(data)
    facts: CameraFacts = make_facts()
    profiles = DeviceProfiles(folder)
    profiles.injection_profile(facts)
    profiles.start_latencies_ns(facts)


def read_picture(data: bytes, folder: Path) -> None:
    """A picture: its size by its header, its EXIF, its pixels."""
    size_of(io.BytesIO(data))
    with suppress(ValueError):
        read_exif(data)
    decode_image(data, colour=True)


def import_file(name: str) -> Reader:
    """A recording, by its file's name: opened, timed, its first frames taken."""

    def read(data: bytes, folder: Path) -> None:
        path = folder / "camera" / name
        _put(path, data)
        with suppress(SimulshotError):
            for source in open_sources([f"a={path if path.suffix != '.jpg' else path.parent}"]):
                source.embedded_times()
                for _ in source.frames(range(1)):
                    pass

    return read


def read_table(data: bytes, folder: Path) -> None:
    """A table of the frames' times."""
    path = folder / "times.csv"
    path.write_bytes(data)
    for camera in "ab":
        for number in range(3):
            _put(folder / camera / f"{number}.jpg", jpeg(number))
    with suppress(SimulshotError):
        timeline_by_table(open_sources([f"{camera}={folder / camera}" for camera in "ab"]), path)


def read_calibration(name: str) -> Reader:
    """A calibration of another program, by its file's name."""

    def read(data: bytes, folder: Path) -> None:
        _put(folder / name, data)
        with suppress(SimulshotError):
            read_views([("", folder / name)], ("left", "right"))

    return read


def import_exported(to: str, name: str) -> Reader:
    """An export of a session in which one file is whatever a stranger made of it, imported again."""

    def read(data: bytes, folder: Path) -> None:
        if to not in _exports:
            taken = _session(folder)
            cameras = {name: calibration_of(name).cameras[name] for name in ("left", "right")}
            _put(taken / CALIBRATION, msgspec.json.encode(Calibration(cameras=cameras)))
            session = Session.open(taken)
            export_session(session, to, folder / "made")
            _exports[to] = _contents(folder / "made")
            shutil.rmtree(folder / "made")
        export = folder / "export"
        for path, content in _exports[to].items():
            _put(export / path, content)
        assert (export / name).is_file()
        _put(export / name, data)
        with suppress(SimulshotError):
            import_recording([str(export)], folder, "imported", ImportOptions())

    return read


_exports: dict[str, dict[Path, bytes]] = {}


def read_rig(name: str) -> Reader:
    """A folder with the calibration of a whole rig, by the name of one file of it."""

    def read(data: bytes, folder: Path) -> None:
        for other in (name, name.replace("intri", "extri").replace("cameras", "images")):
            _put(folder / other, data)
        with suppress(SimulshotError):
            read_views([("", folder)], ("left", "right"))

    return read


def read_known_machines(data: bytes, folder: Path) -> None:
    """The machines that this one knows."""
    _put(folder / FILE, data)
    with suppress(SimulshotError):
        KnownMachines(folder).all()


def read_sealed(data: bytes, folder: Path) -> None:
    """Whatever comes to a leader's port, which answers it by no more bytes; and to a client's."""
    here, there = Address("192.0.2.1", 1), Address("192.0.2.2", 2)
    leader = SealedLeader(Leader(LeaderConfig(1, 0, period_ns=10**7), random.Random(1)))
    leader.receive_datagram(data, here, 1)
    assert sum(len(answer) for answer, _ in leader.datagrams_to_send(1)) <= len(data)
    keys = LeaderKeys()
    for use in (keys.open_group, lambda data: keys.open(data, there)):
        with suppress(SealError):
            use(data)


def read_pairing_word(data: bytes, folder: Path) -> None:
    """What comes in place of a word or a proof of a pairing: it proves nothing."""
    desk = InvitationDesk(lambda: 0.0)
    desk.invite(Role.CAMERA)
    with suppress(SimulshotError):
        _, attempt = desk.answer("a" * 32, data, "b" * 32)
        desk.accept(attempt, data)
        raise AssertionError("it was taken for a proof")


def _contents(folder: Path) -> dict[Path, bytes]:
    return {file.relative_to(folder): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def _session(folder: Path) -> Path:
    """A small session, the same every time."""
    if not _kept:
        with SessionWriter.create(folder, "kept") as writer:
            filled = fill(writer).manifest
        made = folder / "kept"
        _kept.update(
            {file.relative_to(made): file.read_bytes() for file in made.rglob("*") if file.is_file()}
        )
        shutil.rmtree(made)
        plan = BurstPlan(
            name=filled.name,
            created=filled.created,
            software=filled.software,
            leader=1,
            number=1,
            burst=filled.burst,
            cameras=tuple(CameraPlan(camera=camera) for camera in filled.cameras),
        )
        _kept[Path(PLAN)] = msgspec.json.encode(plan)
    session = folder / "small"
    for name, data in _kept.items():
        _put(session / name, data)
    return session


_kept: dict[Path, bytes] = {}


def _put(file: Path, data: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)


_SESSION_FILES: Sequence[str] = (MANIFEST, JOURNAL, CHECKSUMS, PLAN, CALIBRATION, TIMES)

READERS: dict[str, Reader] = {
    "datagram": read_datagram,
    "stream-of-node": read_stream(messages.ToLeader),
    "stream-of-leader": read_stream(messages.FromLeader),
    **{f"session-{Path(name).stem}": read_session_file(name) for name in _SESSION_FILES},
    "repair": repair_session,
    "ground-truth": read_ground_truth,
    "spool": read_spool,
    "profiles": read_profiles,
    "picture": read_picture,
    "import-picture": import_file("000001.jpg"),
    "import-video": import_file("video.mp4"),
    "table": read_table,
    "calibration-toml": read_calibration("camera_array.toml"),
    "calibration-qualisys": read_calibration("rig.qca.txt"),
    "calibration-opencv": read_calibration("left.yml"),
    "calibration-npz": read_calibration("left.npz"),
    "calibration-pickle": read_calibration("cameraIntrinsicsExtrinsics.pickle"),
    "calibration-easymocap": read_rig("intri.yml"),
    "calibration-colmap": read_rig("cameras.bin"),
    "calibration-colmap-text": read_rig("cameras.txt"),
    "export-colmap": import_exported("colmap", "simulshot.json"),
    "export-nerfstudio": import_exported("nerfstudio", "transforms.json"),
    "export-mcap": import_exported("mcap", "kept.mcap"),
    "known-machines": read_known_machines,
    "sealed": read_sealed,
    "pairing": read_pairing_word,
}
"""By name; the corpus of each is `corpus/NAME`."""
