"""Bags of ROS: each topic of pictures is a camera, by the stamps in their headers, arrival beside them.

sensor_msgs CompressedImage (JPEG, PNG) and Image (rgb8, bgr8, mono8) of a rosbag2 folder, a ROS 1 .bag, or an
.mcap of ROS alone; CameraInfo of the same frame or namespace, and a transform to one frame from each camera.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.errors import BadInputError, SimulshotError
from capture_app.names import is_name, name_like
from capture_app.optional_packages import load_optional
from capture_app.session.exchange import ROS_BAGS, ros_messages
from capture_app.session.importers.calibrations.views import View, Views, view_at
from capture_app.session.importers.frame_matching import TimedFrame, timeline_by_times
from capture_app.session.importers.sources import Layout, Source
from capture_app.session.reading.decoding import encode_image, image_size

_COMPRESSED, _RAW = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"
_INFO, _TF = "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"
_CHANNELS = {"rgb8": 3, "bgr8": 3, "mono8": 1, "8UC1": 1, "8UC3": 3}


def is_bag(path: Path) -> bool:
    """Whether a path is a folder of rosbag2, or a bag of ROS 1."""
    return (path / "metadata.yaml").is_file() if path.is_dir() else path.suffix.lower() == ".bag"


class BagImages(Source):
    """The pictures of one topic, in the order of the bag; compressed ones byte for byte."""

    kind = "ROS"
    numbered = False

    def __init__(self, name: str, path: Path, topic: str, count: int, suffix: str) -> None:
        self.name, self.path, self._topic = name, path, topic
        self.numbers, self.suffix = range(count), suffix

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        wanted = set(indices)
        of_topic = (one for topic, kind, _, one in _messages(self.path, _IMAGES) if topic == self._topic)
        for index, message in enumerate(of_topic):
            if index in wanted:
                data = _picture(f"{self.path}: {self._topic}", message)
                size = image_size(data)
                if size is None:
                    raise BadInputError(f"{self.path}: {self._topic} has an image that cannot be decoded")
                yield index, data, size


_IMAGES = (_COMPRESSED, _RAW)


def bag(path: Path) -> Layout:
    """The cameras of a bag. Raises BadInputError where it has no pictures that can be read."""
    times: dict[str, list[TimedFrame]] = {}
    frames: dict[str, str] = {}
    suffixes: dict[str, str] = {}
    lenses: dict[str, tuple[str, Any]] = {}
    poses: dict[str, Any] = {}
    for topic, kind, arrived_ns, message in _messages(path, (*_IMAGES, _INFO, _TF)):
        if kind == _TF:
            poses |= {one.child_frame_id: one for one in message.transforms}
            continue
        stamp = message.header.stamp
        at_ns = stamp.sec * 1_000_000_000 + stamp.nanosec or arrived_ns
        if kind == _INFO:
            lenses[topic.rpartition("/")[0]] = message.header.frame_id, message
            continue
        of = times.setdefault(topic, [])
        of.append(TimedFrame(len(of), at_ns, arrived_ns))
        frames[topic] = message.header.frame_id
        png = "png" in getattr(message, "format", "").lower()
        suffixes[topic] = ".png" if png else ".jpg"
    if not times:
        raise BadInputError(
            f"{path} has no pictures of sensor_msgs", hint="Image and CompressedImage are read"
        )
    names = camera_names(frames)
    ordered = {names[topic]: sorted(of, key=lambda frame: frame.leader_ns) for topic, of in times.items()}
    return Layout(
        program="ROS",
        path=path,
        sources=tuple(
            BagImages(names[topic], path, topic, len(of), suffixes[topic]) for topic, of in times.items()
        ),
        timeline=timeline_by_times(str(path), ordered),
        views=_views(path, names, frames, lenses, poses),
    )


def camera_names(frames: Mapping[str, str]) -> dict[str, str]:
    """Each topic's camera: its frame_id where that is a name and no other topic's, else the topic's own."""
    ids = list(frames.values())
    return {
        topic: own if is_name(own) and ids.count(own) == 1 else name_like(topic.strip("/"), f"camera{number}")
        for number, (topic, own) in enumerate(frames.items())
    }


def _views(
    path: Path,
    names: Mapping[str, str],
    frames: Mapping[str, str],
    lenses: Mapping[str, tuple[str, Any]],
    poses: Mapping[str, Any],
) -> Views | None:
    """The calibration, where every camera has a lens and a place in the same coordinates."""
    views: dict[str, View] = {}
    parents = set()
    for topic, frame in frames.items():
        near = [info for place, (_, info) in lenses.items() if topic.startswith(f"{place}/")]
        own = near or [info for _, (of, info) in lenses.items() if of == frame]
        if not own or frame not in poses:
            return None
        parents.add(poses[frame].header.frame_id)
        turn, at = poses[frame].transform.rotation, poses[frame].transform.translation
        views[names[topic]] = view_at(
            f"{path}: {frame}",
            own[0].k,
            own[0].d,
            (turn.w, turn.x, turn.y, turn.z),
            (at.x, at.y, at.z),
            (own[0].width, own[0].height),
        )
    return Views(views, path.name, "m") if len(parents) == 1 else None


def _picture(where: str, message: Any) -> bytes:
    if not hasattr(message, "encoding"):
        return bytes(message.data)
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        raise BadInputError(f"{where} has pictures of {message.encoding}; {', '.join(_CHANNELS)} are read")
    rows = np.asarray(message.data, np.uint8).reshape(message.height, message.step)
    pixels = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    if message.encoding == "rgb8":
        pixels = pixels[:, :, ::-1]
    return encode_image(np.ascontiguousarray(pixels), ".jpg")


def _messages(path: Path, kinds: Sequence[str]) -> Iterator[tuple[str, str, int, Any]]:
    """Topic, type, when it arrived (ns) and content of the messages of these types, as they came."""
    store = ros_messages()
    try:
        if path.suffix.lower() == ".mcap":
            with path.open("rb") as stream:
                reader = load_optional("mcap.reader", "export", "MCAP").make_reader(stream)
                for schema, channel, message in reader.iter_messages():
                    if schema is not None and channel.message_encoding == "cdr" and schema.name in kinds:
                        content = store.deserialize_cdr(message.data, schema.name)
                        yield channel.topic, schema.name, message.log_time, content
            return
        with load_optional("rosbags.highlevel", "ros", ROS_BAGS).AnyReader(
            [path], default_typestore=store
        ) as found:
            chosen = [one for one in found.connections if one.msgtype in kinds]
            for connection, at_ns, raw in found.messages(connections=chosen) if chosen else ():
                yield connection.topic, connection.msgtype, at_ns, found.deserialize(raw, connection.msgtype)
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error
    except SimulshotError:
        raise
    except Exception as error:  # of a broken file its readers raise a dozen kinds
        raise BadInputError(f"{path} is not an intact bag: {error}") from error
