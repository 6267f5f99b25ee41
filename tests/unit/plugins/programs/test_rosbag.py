"""ROS bags: exports as rosbags reads them, and bags of others as sessions."""

import struct
from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.plugins.programs.mcap import bags
from capture_app.plugins.programs.mcap.mcap_writer import ros_topics
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.imported import import_one
from tests.unit.plugins.programs.conftest import Export, Make, calibrated, picture

rosbag2: Any = None
store: Any = None


@pytest.fixture(scope="module", autouse=True)
def _rosbags() -> None:
    """Import it only where it is used: each of pytest's workers imports all files of tests."""
    from rosbags import rosbag2, typesys

    globals().update(rosbag2=rosbag2, store=typesys.get_typestore(typesys.Stores.ROS2_JAZZY))


def test_every_picture_lens_and_place_is_in_the_bag(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    export(session, "mcap", ros=True)
    images = {(i.camera, i.leader_ns): i for i in session.manifest.images}
    seen: Counter[str] = Counter()
    from rosbags.highlevel import AnyReader

    with AnyReader([tmp_path / "out" / "clap"]) as bag:
        for connection, at_ns, raw in bag.messages():
            message: Any = bag.deserialize(raw, connection.msgtype)
            seen[connection.topic] += 1
            if connection.msgtype == "tf2_msgs/msg/TFMessage":
                for one in message.transforms:
                    truth = calibrated(one.child_frame_id)
                    at = one.transform.translation
                    place = -np.array(truth.rotation).T @ np.array(truth.translation)
                    assert [at.x, at.y, at.z] == pytest.approx(place, abs=1e-12)
                    assert one.header.frame_id == "rig"
                continue
            stamp, camera = message.header.stamp, message.header.frame_id
            image = images[camera, stamp.sec * 10**9 + stamp.nanosec]
            assert at_ns == image.leader_ns
            if connection.topic == f"/{camera}/image_raw/compressed":
                assert (message.format, bytes(message.data)) == (
                    "jpeg",
                    session.image_file(image).read_bytes(),
                )
            else:
                assert connection.topic == f"/{camera}/camera_info"
                truth = calibrated(camera)
                assert list(message.k) == [truth.fx, 0, truth.cx, 0, truth.fy, truth.cy, 0, 0, 1]
                assert list(message.d) == list(truth.distortion)
                assert (message.width, message.height, len(message.p)) == (truth.width, truth.height, 12)
    assert seen["/tf_static"] == 1
    cameras = Counter(image.camera for image in session.manifest.images)
    for kind in ("image_raw/compressed", "camera_info"):
        assert {name: seen[f"/{name}/{kind}"] for name in cameras} == dict(cameras)
    with (tmp_path / "out" / "clap" / "clap.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        assert {channel.message_encoding for _, channel, _ in reader.iter_messages()} == {"cdr"}


def test_an_export_comes_back_as_the_session_it_was(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    export(session, "mcap", ros=True)
    back = import_one([str(tmp_path / "out")], tmp_path / "back", "back", ImportOptions())
    assert verify(back) == []
    assert {(i.camera, i.instant, i.sha256, i.leader_ns) for i in back.manifest.images} == {
        (i.camera, i.instant, i.sha256, i.leader_ns) for i in session.manifest.images
    }
    assert back.calibration() == session.calibration()
    # And without what only we wrote beside it, the lone file too.
    for path in (tmp_path / "out" / "clap", tmp_path / "out" / "clap" / "clap.mcap"):
        alone = import_one([str(path)], tmp_path / path.name, "alone", ImportOptions())
        found, truth = alone.calibration(), session.calibration()
        assert found is not None
        assert truth is not None
        for name, camera in truth.cameras.items():
            assert np.array(found.cameras[name].rotation) == pytest.approx(
                np.array(camera.rotation), abs=1e-9
            )
            assert found.cameras[name].translation == pytest.approx(camera.translation, abs=1e-9)
        stamps = {(i.camera, i.leader_ns) for i in alone.manifest.images}
        assert stamps == {(i.camera, i.leader_ns) for i in session.manifest.images}


def test_no_two_cameras_share_a_topic() -> None:
    assert len(set(ros_topics(["a-b", "a_b", "a_b_2"]).values())) == 3
    assert ros_topics(["a-b", "2nd", "a_b"]) == {"a_b": "/a_b", "a-b": "/a_b_2", "2nd": "/cam2nd"}


def test_stamps_of_zero_are_said_and_no_clock_is_mixed_with_another(tmp_path: Path) -> None:
    """As of a driver that leaves them out; then all cameras have their times of arrival."""
    kind = "sensor_msgs/msg/Image"
    with rosbag2.Writer(tmp_path / "drive", version=8) as writer:
        topics = {n: writer.add_connection(f"/cam{n}/image_raw", kind, typestore=store) for n in (1, 2)}
        for k in range(3):
            for n, topic in topics.items():
                at_ns = 1_700_000_000 * 10**9 + k * 40_000_000 + n * 1_000_000
                # The second camera's driver stamps, 5 s before the bag's clock.
                stamp_ns = 0 if n == 1 else at_ns - 5 * 10**9
                stamp = store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
                message = store.types[kind](
                    header=store.types["std_msgs/msg/Header"](stamp, f"cam{n}"),
                    height=12,
                    width=16,
                    encoding="mono8",
                    is_bigendian=0,
                    step=16,
                    data=np.full(192, 90, np.uint8),
                )
                writer.write(topic, at_ns, store.serialize_cdr(message, kind))
    session = import_one([str(tmp_path / "drive")], tmp_path, "s", ImportOptions())
    times = session.manifest.burst.common_times
    assert times is not None
    assert times.reason == "times of arrival in the bag, as stamps of /cam1/image_raw are zero"
    assert [len(images) for images in session.images_by_instant()] == [2, 2, 2]
    assert {image.leader_ns % 40_000_000 for image in session.manifest.images} == {1_000_000, 2_000_000}


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_stamps_and_arrival_of_a_strangers_bag(
    tmp_path: Path, plugin: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Raw pictures of a driver (rgb8), which came 20 ms after their stamps, and later from one camera."""
    kind = "sensor_msgs/msg/Image"
    stored = rosbag2.StoragePlugin[plugin]
    with rosbag2.Writer(tmp_path / "drive", version=9, storage_plugin=stored) as writer:
        topics = {n: writer.add_connection(f"/cam{n}/image_raw", kind, typestore=store) for n in (1, 2)}
        for k in range(3):
            for n, topic in topics.items():
                at_ns = 1_700_000_000 * 10**9 + k * 40_000_000 + n * 1_000_000
                pixels = picture("left", k)[:, :, ::-1]
                stamp = store.types["builtin_interfaces/msg/Time"](*divmod(at_ns, 10**9))
                message = store.types[kind](
                    header=store.types["std_msgs/msg/Header"](stamp, "optical"),
                    height=64,
                    width=96,
                    encoding="rgb8",
                    is_bigendian=0,
                    step=96 * 3,
                    data=np.ascontiguousarray(pixels).ravel(),
                )
                writer.write(topic, at_ns + n * 20_000_000, store.serialize_cdr(message, kind))
    assert run(["sessions", "import", str(tmp_path / "drive"), "--out", str(tmp_path / "out")]) == ExitCode.OK
    session = Session.open(tmp_path / "out" / "drive")
    assert "common times recorded" in capsys.readouterr().out
    assert [len(images) for images in session.images_by_instant()] == [2, 2, 2]
    for image in session.manifest.images:
        assert (image.local_ns or 0) - image.leader_ns == int(image.camera[3]) * 20_000_000
    record = session.images_by_instant()[1]["cam1-image_raw"]
    found = cv2.imread(str(session.image_file(record)))
    assert found is not None
    assert np.abs(found.astype(int) - picture("left", 1)).max() < 12


def test_a_compressed_message_that_unpacks_to_far_more_than_a_picture_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kind = "sensor_msgs/msg/Image"
    writer = rosbag2.Writer(tmp_path / "drive", version=8)
    writer.set_compression(rosbag2.CompressionMode.MESSAGE, rosbag2.CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/cam/image_raw", kind, typestore=store)
        writer.write(topic, 1, bytes(5000))
    monkeypatch.setattr("capture_app.plugins.programs.mcap.bags._MAX_CHUNK", 4000)
    call = ["sessions", "import", str(tmp_path / "drive"), "--out", str(tmp_path / "out")]
    assert run(call) == ExitCode.BAD_INPUT
    assert "4,000 at most are read" in capsys.readouterr().err


@pytest.mark.parametrize(("expansion", "said"), [(2, "times its size"), (10_000, "not an intact bag")])
def test_a_whole_bag_is_unpacked_to_a_multiple_of_its_size(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    expansion: int,
    said: str,
) -> None:
    """Its pictures are blank, and no messages: within the limit, their reader refuses them."""
    writer = rosbag2.Writer(tmp_path / "drive", version=8)
    writer.set_compression(rosbag2.CompressionMode.FILE, rosbag2.CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/cam/image_raw", "sensor_msgs/msg/Image", typestore=store)
        writer.write(topic, 1, bytes(1_000_000))
    monkeypatch.setattr(bags, "_MAX_EXPANSION", expansion)
    call = ["sessions", "import", str(tmp_path / "drive"), "--out", str(tmp_path / "out")]
    assert run(call) == ExitCode.BAD_INPUT
    assert said in capsys.readouterr().err


def test_what_is_no_bag_of_pictures_is_said(tmp_path: Path) -> None:
    stored = rosbag2.StoragePlugin.MCAP
    with rosbag2.Writer(tmp_path / "words", version=9, storage_plugin=stored) as writer:
        topic = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        text = store.types["std_msgs/msg/String"]("hello")
        writer.write(topic, 1, store.serialize_cdr(text, "std_msgs/msg/String"))
    with pytest.raises(BadInputError, match="no pictures of sensor_msgs"):
        import_one([str(tmp_path / "words")], tmp_path, "s", ImportOptions())
    (tmp_path / "broken.bag").write_bytes(b"#ROSBAG V2.0\n nothing more")
    with pytest.raises(BadInputError, match=r"broken\.bag is not an intact bag"):
        import_one([str(tmp_path / "broken.bag")], tmp_path, "s", ImportOptions())


def test_ros_is_for_mcap_only(make: Make, export: Export) -> None:
    with pytest.raises(BadInputError, match="takes no --ros"):
        export(make(), "colmap", ros=True)


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_a_chunk_of_a_bag_is_unpacked_to_its_limit(
    compression: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rosbags.rosbag1 import Writer

    monkeypatch.setattr(bags, "_MAX_CHUNK", 100_000)
    bag = tmp_path / "zeros.bag"
    with closing(Writer(bag)) as writer:
        writer.set_compression(Writer.CompressionFormat[compression])
        writer.open()
        connection = writer.add_connection("/a/image", "sensor_msgs/msg/Image", typestore=store)
        writer.write(connection, 1, bytes(200_000))
    with pytest.raises(BadInputError, match=r"zeros\.bag is not an intact bag: it has .* bytes in a chunk"):
        import_one([str(bag)], tmp_path, "s", ImportOptions())


def test_the_files_of_a_bags_folder_have_budgets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("a: &a [*a]")
    with pytest.raises(BadInputError, match=r"cannot read .*metadata\.yaml: it has 12,001 values"):
        import_one([str(bag)], tmp_path, "s", ImportOptions())
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    monkeypatch.setattr(bags, "_MAX_CHUNK", 100)
    (bag / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, 1000) + bytes(1000))
    with pytest.raises(BadInputError, match=r"a\.mcap has a chunk of over"):
        import_one([str(bag)], tmp_path, "s", ImportOptions())
