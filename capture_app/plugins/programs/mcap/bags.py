"""Recordings of messages: each topic of images is a camera, timed by the messages' stamps.

Supported are .mcap files of Foxglove's CompressedImage, CameraCalibration and FrameTransform
(docs.foxglove.dev, "Message schemas") in protobuf, and sensor_msgs CompressedImage (JPEG, PNG) and Image
(rgb8, bgr8, mono8) of ROS in a rosbag2 folder, a ROS 1 .bag, or an .mcap of ROS alone. Of ROS, arrival times
are read beside the stamps. A camera has the lens of its frame or namespace; a transform is the pose of the
child in the parent's coordinates.
"""

import struct
from bz2 import BZ2Decompressor
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from capture_app.common.errors import BadInputError, reading
from capture_app.common.names import is_name, name_like
from capture_app.common.optional_packages import load_optional
from capture_app.plugins.programs.mcap.camera_info import view_of_info
from capture_app.session.files.untrusted_files import open_regular, rejecting, within
from capture_app.session.importing.frame_matching import TimedFrame, timeline_by_times
from capture_app.session.importing.opencv_storage import read_storage
from capture_app.session.importing.recording_sources import Layout, Source
from capture_app.session.importing.views import View, Views, from_quaternion
from capture_app.session.reading.decoding import encode_image, image_size

MCAP, METADATA = ".mcap", "metadata.yaml"
ROS_BAGS = "ROS bags"
"""What the package rosbags is needed for, in words."""
_MAGIC_BYTES, _CHUNK, _MAX_CHUNK = 8, 0x06, 1 << 26
"""Length of the file's magic, opcode of a chunk record, and the largest chunk that is unpacked, bytes."""
_MAX_EXPANSION = 200
"""Largest size to which a bag that is compressed as a whole is unpacked, relative to its file's."""
_FOXGLOVE = "foxglove."
_PICTURES = (
    "foxglove.CompressedImage", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"
)  # fmt: skip
_LENSES = ("foxglove.CameraCalibration", "sensor_msgs/msg/CameraInfo")
_POSES = ("foxglove.FrameTransform", "tf2_msgs/msg/TFMessage")
_CHANNELS = {"rgb8": 3, "bgr8": 3, "mono8": 1, "8UC1": 1, "8UC3": 3}
_NO_LENS = "import with --calibration PATH, or calibrate the session: reconstruct calibrate SESSION"
_ENCODINGS = {True: "protobuf", False: "cdr"}
"""Message encoding: Foxglove's (True), and ROS 2's."""
_RECOVER = "copy it from the recorder again; `mcap recover` repairs an interrupted .mcap"


def foxglove_message(name: str) -> Any:
    """Return the class of a Foxglove message, such as CompressedImage. Raises NotAvailableError."""
    return getattr(load_optional(f"foxglove_schemas_protobuf.{name}_pb2", "export", "MCAP"), name)


@cache
def ros_messages() -> Any:
    """Return the types of ROS 2's messages, as of Humble. Raises NotAvailableError without rosbags."""
    typesys = load_optional("rosbags.typesys", "ros", ROS_BAGS)
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def is_bag(path: Path) -> bool:
    """Return whether a path is an .mcap, a rosbag2 folder, or a ROS 1 bag."""
    return (path / METADATA).is_file() if path.is_dir() else path.suffix.lower() in (MCAP, ".bag")


class _Message(NamedTuple):
    """A message on a topic: its type, arrival time (ns), and sequence number if it has one."""

    topic: str
    kind: str
    arrived_ns: int
    sequence: int
    content: Any

    @property
    def frame_id(self) -> str:
        return str(self.content.frame_id if self.kind.startswith(_FOXGLOVE) else self.content.header.frame_id)

    @property
    def timed(self) -> tuple[int, int | None]:
        """Return the message's timestamp, 0 if it has none, and, if recorded separately, its arrival; ns."""
        if self.kind.startswith(_FOXGLOVE):
            stamp = self.content.timestamp
            return stamp.seconds * 1_000_000_000 + stamp.nanos, None
        stamp = self.content.header.stamp
        return stamp.sec * 1_000_000_000 + stamp.nanosec, self.arrived_ns


class TopicPictures(Source):
    """The images of one topic, in recording order; compressed ones unchanged."""

    def __init__(self, name: str, path: Path, first: _Message, count: int) -> None:
        self.name, self.path, self._topic = name, path, first.topic
        self.numbers, self.kind = range(count), "MCAP" if first.kind.startswith(_FOXGLOVE) else "ROS"
        format_ = getattr(first.content, "format", "").lower()
        if format_ and "png" not in format_ and "jp" not in format_:
            raise BadInputError(
                f"{path}: {first.topic} has images of format {format_!r}; JPEG and PNG are read",
                hint="record JPEG or PNG, or import videos or folders of images instead",
            )
        self.suffix = ".png" if "png" in format_ else ".jpg"

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        requested = set(indices)
        for index, message in enumerate(_messages(self.path, _PICTURES, [self._topic])):
            if index in requested:
                data = _picture(f"{self.path}: {self._topic}", message.content)
                if (size := image_size(data)) is None:
                    raise BadInputError(
                        f"{self.path}: {self._topic} has an image that cannot be decoded", hint=_RECOVER
                    )
                yield index, data, size


def read_bag(path: Path) -> tuple[Layout, dict[tuple[str, int], int]]:
    """Read a recording: its cameras, timed by its stamps, with its calibration if that is complete.

    Also return the index of each message's frame, by camera and the message's sequence number. Raises
    BadInputError if there are no readable images.
    """
    first: dict[str, _Message] = {}
    times: dict[str, list[TimedFrame]] = {}
    numbers: dict[str, list[int]] = {}
    arrivals: dict[str, list[int]] = {}
    lenses: dict[str, _Message] = {}
    poses: dict[str, tuple[str, Any]] = {}
    for message in _messages(path, (*_PICTURES, *_LENSES, *_POSES)):
        topic, kind, _, sequence, content = message
        if kind in _PICTURES:
            frames = times.setdefault(first.setdefault(topic, message).topic, [])
            frames.append(TimedFrame(len(frames), *message.timed))
            arrivals.setdefault(topic, []).append(message.arrived_ns)
            numbers.setdefault(topic, []).append(sequence)
        elif kind in _LENSES:
            lenses[topic] = message
        elif kind.startswith(_FOXGLOVE):
            poses[content.child_frame_id] = content.parent_frame_id, content
        else:
            poses |= {
                transform.child_frame_id: (transform.header.frame_id, transform.transform)
                for transform in content.transforms
            }
    if not first:
        raise BadInputError(
            f"{path} has no foxglove.CompressedImage in protobuf and no pictures of sensor_msgs",
            hint="record one of these, or import videos or folders of images",
        )
    names = _camera_names({topic: of.frame_id for topic, of in first.items()})
    sources = [TopicPictures(name, path, first[topic], len(times[topic])) for topic, name in names.items()]
    unstamped = [topic for topic, frames in times.items() if not all(frame.leader_ns for frame in frames)]
    if unstamped:
        # Stamps and times of arrival are of two clocks.
        times = {
            topic: [
                replace(frame, leader_ns=at_ns)
                for frame, at_ns in zip(own_times, arrivals[topic], strict=True)
            ]
            for topic, own_times in times.items()
        }
    stamped = {name: sorted(times[topic], key=lambda frame: frame.leader_ns) for topic, name in names.items()}
    views, refused = None, []
    try:
        views = _views(path, {names[topic]: of for topic, of in first.items()}, lenses, poses)
    except BadInputError as error:
        refused = [f"the calibration in it is not taken: {error.what}"]
    layout = Layout(
        program=sources[0].kind,
        path=path,
        sources=tuple(sources),
        timeline=timeline_by_times(str(path), stamped),
        views=views,
        times_of=f"arrival in the bag, as stamps of {', '.join(unstamped)} are zero" if unstamped else "",
        notes=refused,
    )
    return layout, {
        (name, one): index for topic, name in names.items() for index, one in enumerate(numbers[topic])
    }


def _camera_names(frames: Mapping[str, str]) -> dict[str, str]:
    """Return each topic's camera name: its frame_id if that is a valid and unique name, or the topic."""
    ids = list(frames.values())
    return {
        topic: own if is_name(own) and ids.count(own) == 1 else name_like(topic.strip("/"), f"camera{number}")
        for number, (topic, own) in enumerate(frames.items())
    }


def _views(
    path: Path,
    cameras: Mapping[str, _Message],
    lenses: Mapping[str, _Message],
    poses: Mapping[str, tuple[str, Any]],
) -> Views | None:
    """Return the calibration if every camera has a lens and a pose in common coordinates."""
    views: dict[str, View] = {}
    for name, picture in cameras.items():
        if (lens := _lens_of(picture, lenses.values())) is None or picture.frame_id not in poses:
            return None
        where = f"{path}: {picture.frame_id}"
        _, pose = poses[picture.frame_id]
        rotated, at = pose.rotation, pose.translation
        k, d = (lens.K, lens.D) if hasattr(lens, "K") else (lens.k, lens.d)
        info = {"K": list(k), "D": list(d), "WIDTH": lens.width, "HEIGHT": lens.height}
        info["distortion_model"] = lens.distortion_model
        rotation = from_quaternion(where, (rotated.w, rotated.x, rotated.y, rotated.z)).T
        if "rect" in picture.topic.rpartition("/")[2]:
            raise BadInputError(f"{where}: {picture.topic} is rectified, and its lens is not", hint=_NO_LENS)
        place = -rotation @ np.array([at.x, at.y, at.z])
        views[name] = view_of_info(where, info, rotation, place, _NO_LENS)
    one_world = len({poses[picture.frame_id][0] for picture in cameras.values()}) == 1
    return Views(views, path.name, "m") if one_world else None


def _lens_of(picture: _Message, lenses: Collection[_Message]) -> Any:
    """Return the lens of an image's namespace and frame, otherwise of its frame or its namespace, or None."""
    near = [lens for lens in lenses if picture.topic.startswith(f"{lens.topic.rpartition('/')[0]}/")]
    own = [lens for lens in lenses if lens.frame_id == picture.frame_id]
    chosen = [one for one in near if one in own] or own or near
    return chosen[0].content if chosen else None


def _picture(where: str, message: Any) -> bytes:
    if not hasattr(message, "encoding"):
        return bytes(message.data)
    if (channels := _CHANNELS.get(message.encoding)) is None:
        raise BadInputError(
            f"{where} has images of encoding {message.encoding}; {', '.join(_CHANNELS)} are supported",
            hint="record one of these encodings, or compressed images",
        )
    rows = np.asarray(message.data, np.uint8).reshape(message.height, message.step)
    pixels = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    bgr = pixels[:, :, ::-1] if message.encoding == "rgb8" else pixels
    return encode_image(np.ascontiguousarray(bgr), ".jpg")


def attachments(path: Path) -> dict[str, bytes]:
    """Return the attachments of an .mcap, by name. Raises BadInputError if the file is damaged."""
    if path.suffix.lower() != MCAP:
        return {}
    with intact(path), _open_mcap(path) as stream:
        reader = load_optional("mcap.stream_reader", "export", "MCAP")
        records = reader.StreamReader(stream, emit_chunks=True).records
        return {record.name: record.data for record in records if isinstance(record, reader.Attachment)}


def _messages(path: Path, kinds: Collection[str], topics: Sequence[str] = ()) -> Iterator[_Message]:
    """Yield the messages of these types, on these topics or on all, in recording order."""
    with intact(path):
        if path.suffix.lower() == MCAP:
            with _open_mcap(path) as stream:
                # It reads the chunks that were checked; the other reader follows an index to any place.
                reader = load_optional("mcap.reader", "export", "MCAP").NonSeekingReader(stream)
                for schema, channel, message in reader.iter_messages(topics or None, log_time_order=False):
                    kind = schema.name if schema else ""
                    if kind in kinds and channel.message_encoding == _ENCODINGS[kind.startswith(_FOXGLOVE)]:
                        yield _Message(
                            channel.topic,
                            kind,
                            message.log_time,
                            message.sequence,
                            _decode(kind, message.data),
                        )
            return
        reader = load_optional("rosbags.highlevel", "ros", ROS_BAGS).AnyReader
        lz4 = load_optional("lz4.frame", "ros", ROS_BAGS)
        # rosbags itself unpacks chunks and messages of any size.
        ros2 = load_optional("rosbags.rosbag2.reader", "ros", ROS_BAGS)
        decompressor = ros2.zstd.ZstdDecompressor
        ros2.zstd = SimpleNamespace(
            open=ros2.zstd.open,
            ZstdDecompressor=decompressor,
            decompress=lambda message: _unpack(decompressor(), message),
        )
        load_optional("rosbags.rosbag1.reader", "ros", ROS_BAGS).decompressors |= {
            "bz2": lambda chunk: _unpack(BZ2Decompressor(), chunk),
            "lz4": lambda chunk: _unpack(lz4.LZ4FrameDecompressor(), chunk),
        }
        if path.is_dir():
            read_storage(path / METADATA, hint=_RECOVER)
        for file in path.glob(f"*{MCAP}"):
            with _open_mcap(file):
                pass
        for file in path.glob("*.zstd"):
            # rosbags unpacks it to the disk, whatever its size.
            with open_regular(file) as packed, ros2.zstd.open(packed, "rb") as unpacked:
                unpacked.seek(_MAX_EXPANSION * file.stat().st_size)
                within(
                    len(unpacked.read(1)), 0, f"bytes in {file.name} beyond {_MAX_EXPANSION} times its size"
                )
        with reader([path], default_typestore=ros_messages()) as bag:
            chosen = [
                connection
                for connection in bag.connections
                if connection.msgtype in kinds and connection.topic in (topics or [connection.topic])
            ]
            for of, at_ns, raw in bag.messages(connections=chosen) if chosen else ():
                yield _Message(of.topic, of.msgtype, at_ns, 0, bag.deserialize(raw, of.msgtype))


@contextmanager
def _open_mcap(path: Path) -> Iterator[BinaryIO]:
    """Open an .mcap none of whose chunks unpacks to more than _MAX_CHUNK. Raises BadInputError, OSError."""
    with open_regular(path) as stream:
        stream.seek(_MAGIC_BYTES)
        while len(head := stream.read(9)) == 9:
            kind, length = struct.unpack("<BQ", head)
            end = stream.tell() + length
            if kind == _CHUNK:
                _start, _end, size, _crc, name = struct.unpack("<QQQII", stream.read(32))
                compression = stream.read(min(name, 16))
                if max(size, length) > _MAX_CHUNK or _unpacked(compression, stream.read(length)) > _MAX_CHUNK:
                    raise BadInputError(
                        f"{path} has a chunk of over {_MAX_CHUNK >> 20} MiB",
                        hint=f"write smaller ones: mcap compress {path} --chunk-size 4194304 -o OUT.mcap",
                    )
            stream.seek(end)
        stream.seek(0)
        yield stream


def _unpacked(compression: bytes, rest: bytes) -> int:
    """Return the size (bytes) that a chunk's data claims for itself, which need not be the chunk's claim."""
    data = rest[8:]
    if compression == b"zstd":
        return int(load_optional("zstandard", "export", "MCAP").frame_content_size(data))
    if compression == b"lz4":
        decompressor = load_optional("lz4.frame", "export", "MCAP").LZ4FrameDecompressor()
        return len(decompressor.decompress(data, max_length=_MAX_CHUNK + 1))
    return len(data)


def _unpack(decompressor: Any, data: bytes) -> bytes:
    """Unpack a ROS bag's chunk or message. Raises ValueError if it has more than _MAX_CHUNK bytes."""
    unpacked: bytes = decompressor.decompress(data, max_length=_MAX_CHUNK + 1)
    within(len(unpacked), _MAX_CHUNK, "bytes in a chunk or message")
    return unpacked


def _decode(kind: str, data: bytes) -> Any:
    if kind.startswith(_FOXGLOVE):
        return foxglove_message(kind.removeprefix(_FOXGLOVE)).FromString(data)
    return ros_messages().deserialize_cdr(data, kind)


@contextmanager
def intact(path: Path) -> Iterator[None]:
    """Convert any error of a reader on a damaged recording to BadInputError."""
    what = f"{path} is not an intact {'MCAP' if path.suffix.lower() == MCAP else 'bag'}"
    # The readers raise a dozen kinds on a damaged file.
    with rejecting(what, Exception, hint=_RECOVER), reading(path):
        yield
