"""Our own exports are the session again that they were made of; of another MCAP, each topic is a camera.

An export has `frames.csv` and `simulshot.json`, an MCAP of ours the session's manifest and calibration
attached. The messages are Foxglove's (docs.foxglove.dev, "Message schemas"): CompressedImage,
CameraCalibration, and FrameTransform, which is where the child is in the parent's coordinates.
"""

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from capture_app.errors import BadInputError, SimulshotError
from capture_app.optional_packages import load_optional
from capture_app.session.exchange import FRAMES, ExportRecord, message_class, read_record
from capture_app.session.files.strangers import read_text
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.checks import check_references, decode_struct, inside
from capture_app.session.format.manifest import CALIBRATION, MANIFEST, SCHEMA_VERSION, ImageRecord, Manifest
from capture_app.session.importers.calibrations.views import View, Views, view_at
from capture_app.session.importers.frame_matching import Instant, TimedFrame, Timeline, timeline_by_times
from capture_app.session.importers.rosbag import bag, camera_names
from capture_app.session.importers.sources import VIDEO_SUFFIXES, Images, Layout, Source, Video
from capture_app.session.reading.decoding import image_size

Place = tuple[str, int]
"""A camera and an instant of the session that was exported."""

_UNREADABLE = ("rrd",)
_OF_THE_FRAME = (
    "uncertainty_ns", "hard_bound_ns", "exposure_start_ns", "exposure_ns", "gain", "white_balance",
    "sequence", "outlier_ns", "alignment_offset_ns", "substitute", "late",
)  # fmt: skip
_LEFT_OUT = "the export does not have it"


def exported(folder: Path, *, png: bool) -> Layout:
    """An export's folder. Raises BadInputError where what it says of itself is broken."""
    record = read_record(folder)
    if record.format in _UNREADABLE:
        raise BadInputError(f"{folder} is an export for {record.format}, which cannot be read back")
    if record.format == "mcap":
        files = sorted(folder.glob("*.mcap"))
        if not files and (bags := sorted(path.parent for path in folder.glob("*/metadata.yaml"))):
            return _of_bag(folder, bags[0], record)
        if len(files) != 1:
            raise BadInputError(f"{folder} does not have one .mcap but {len(files)}")
        return mcap(files[0])
    rows = _rows(folder)
    sources: list[Source] = []
    places: dict[Place, int] = {}
    for camera in record.manifest.cameras:
        own = {at: row for at, row in rows.items() if at[0] == camera.name and row[0].is_file()}
        if not own:
            continue
        files = [file for file, _ in own.values()]
        if files[0].suffix.lower() in VIDEO_SUFFIXES:
            video = Video(camera.name, files[0], png=png)
            video.use_embedded_times()
            sources.append(video)
            places.update({at: number for at, (_, number) in own.items()})
        else:
            sources.append(Images(camera.name, files[0].parent, files, "exported images"))
            places.update({at: index for index, at in enumerate(own)})
    if not sources:
        raise BadInputError(f"{folder} has none of the files that its {FRAMES} names")
    return layout_of_record(folder, record, sources, places)


def _of_bag(folder: Path, path: Path, record: ExportRecord) -> Layout:
    rows = sorted(_rows(folder).items(), key=lambda row: row[1][1])
    cameras = {camera for (camera, _), _ in rows}
    places = {
        at: number for camera in cameras for number, at in enumerate(at for at, _ in rows if at[0] == camera)
    }
    return layout_of_record(folder, record, bag(path).sources, places)


def layout_of_record(
    path: Path, record: ExportRecord, sources: Sequence[Source], places: Mapping[Place, int]
) -> Layout:
    """The layout of what was exported; `places` says which frame of its source is of which place."""
    order = [camera.name for camera in record.manifest.cameras]
    sources = sorted((one for one in sources if one.name in order), key=lambda one: order.index(one.name))
    return Layout(
        program=f"simulshot: the session {record.manifest.name}, exported for {record.format}",
        path=path,
        sources=tuple(sources),
        timeline=_timeline(record.manifest, places, {source.name for source in sources}),
        record=record,
    )


def calibration_of_record(record: ExportRecord, sizes: Mapping[str, tuple[int, int]]) -> Calibration | None:
    """The calibration that was exported. Raises BadInputError where the images are of another size now."""
    for name, camera in record.calibration.cameras.items() if record.calibration else ():
        if sizes.get(name, (camera.width, camera.height)) != (camera.width, camera.height):
            was, now = f"{camera.width}x{camera.height}", "x".join(map(str, sizes[name]))
            raise BadInputError(
                f"{name} was exported with {was} pixels and has {now} now",
                hint="--calibration takes one that fits",
            )
    return record.calibration


def _rows(folder: Path) -> dict[Place, tuple[Path, int]]:
    """The file, and the number of its frame, of every place that the export has."""
    path = folder / FRAMES
    try:
        return {
            (row["camera"], int(row["instant"])): (inside(folder, row["file"]), int(row["frame"]))
            for row in csv.DictReader(read_text(path).splitlines())
            if row["file"] and row["content"] in ("image", "substitute")
        }
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise BadInputError(f"{path} is not the table of an export: {error}") from error


def _timeline(manifest: Manifest, places: Mapping[Place, int], cameras: set[str]) -> Timeline:
    recorded = {(image.camera, image.instant): image for image in manifest.images}
    # A frame that stands for two instants is in an export once.
    by_content = {(at[0], recorded[at].sha256): index for at, index in places.items() if at in recorded}
    why = {(gone.camera, gone.instant): gone.reason for gone in manifest.missing}
    instants = []
    for number, at_ns in enumerate(manifest.burst.instants_ns):
        here = {name: recorded[name, number] for name in cameras if (name, number) in recorded}
        frames = {
            name: _timed(index, image)
            for name, image in here.items()
            if (index := places.get((name, number), by_content.get((name, image.sha256)))) is not None
        }
        if here and not frames:  # an export of some of the instants
            continue
        gone = {name: why.get((name, number), _LEFT_OUT) for name in cameras if name not in frames}
        instants.append(Instant(at_ns, frames, gone))
    periods = {camera.name: camera.facts.period_ns for camera in manifest.cameras if camera.name in cameras}
    return Timeline(instants, manifest.burst.period_ns, periods)


def _timed(index: int, image: ImageRecord) -> TimedFrame:
    further: dict[str, Any] = {key: getattr(image, key) for key in _OF_THE_FRAME}
    return TimedFrame(index, image.leader_ns, image.local_ns, further)


_IMAGE, _LENS, _POSE = (
    f"foxglove.{name}" for name in ("CompressedImage", "CameraCalibration", "FrameTransform")
)
_SUFFIXES = {"jpeg": ".jpg", "jpg": ".jpg", "png": ".png"}


class _Message(NamedTuple):
    """What is kept of an image's message: its number and its time in ns."""

    frame_id: str
    format: str
    sequence: int
    at_ns: int


class McapImages(Source):
    """The images of one topic, byte for byte, in the order of the file."""

    kind = "MCAP"
    numbered = False

    def __init__(self, name: str, path: Path, topic: str, format_: str, count: int) -> None:
        self.name, self.path, self._topic = name, path, topic
        self.numbers = range(count)
        if format_ not in _SUFFIXES:
            raise BadInputError(f"{path}: {topic} has images of format {format_!r}; JPEG and PNG are read")
        self.suffix = _SUFFIXES[format_]

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        wanted = set(indices)
        with _reader(self.path) as reader:
            for index, (_, _, message) in enumerate(
                reader.iter_messages(topics=[self._topic], log_time_order=False)
            ):
                if index in wanted:
                    data = bytes(_decode(_IMAGE, message.data).data)
                    size = image_size(data)
                    if size is None:
                        raise BadInputError(f"{self.path}: {self._topic} has an image that cannot be decoded")
                    yield index, data, size


def mcap(path: Path) -> Layout:
    """The cameras of an .mcap. Raises BadInputError where it has no images that can be read."""
    lenses: dict[str, Any] = {}
    poses: dict[str, Any] = {}
    topics: dict[str, list[_Message]] = {}
    ros = False
    with _reader(path) as reader:
        attached = {one.name: one.data for one in reader.iter_attachments()}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            ros = ros or channel.message_encoding == "cdr"
            if schema is None or channel.message_encoding != "protobuf":
                continue
            if schema.name == _IMAGE:
                one = _decode(_IMAGE, message.data)
                at_ns = one.timestamp.seconds * 1_000_000_000 + one.timestamp.nanos or message.log_time
                kept = _Message(one.frame_id, one.format.lower(), message.sequence, at_ns)
                topics.setdefault(channel.topic, []).append(kept)
            elif schema.name == _LENS:
                lens = _decode(_LENS, message.data)
                lenses[lens.frame_id] = lens
            elif schema.name == _POSE:
                pose = _decode(_POSE, message.data)
                poses[pose.child_frame_id] = pose
    if not topics and ros:
        return bag(path)
    if not topics:
        raise BadInputError(
            f"{path} has no {_IMAGE} in protobuf", hint="images of other schemas are not read"
        )
    names = camera_names({topic: messages[0].frame_id for topic, messages in topics.items()})
    sources = [
        McapImages(name, path, topic, topics[topic][0].format, len(topics[topic]))
        for topic, name in names.items()
    ]
    if MANIFEST in attached:
        places = {
            (name, one.sequence): index
            for topic, name in names.items()
            for index, one in enumerate(topics[topic])
        }
        return layout_of_record(path, _record(path, attached), sources, places)
    times = {
        name: sorted(
            (TimedFrame(n, one.at_ns) for n, one in enumerate(topics[topic])),
            key=lambda frame: frame.leader_ns,
        )
        for topic, name in names.items()
    }
    return Layout(
        program="MCAP",
        path=path,
        sources=tuple(sources),
        timeline=timeline_by_times(str(path), times),
        views=_views(path, {topics[topic][0].frame_id: name for topic, name in names.items()}, lenses, poses),
    )


def _record(path: Path, attached: Mapping[str, bytes]) -> ExportRecord:
    manifest = decode_struct(path / MANIFEST, attached[MANIFEST], Manifest, SCHEMA_VERSION)
    check_references(path / MANIFEST, manifest)
    data = attached.get(CALIBRATION)
    calibration = None if data is None else decode_struct(path / CALIBRATION, data, Calibration, 1)
    return ExportRecord(format="mcap", manifest=manifest, calibration=calibration)


def _views(
    path: Path, names: Mapping[str, str], lenses: Mapping[str, Any], poses: Mapping[str, Any]
) -> Views | None:
    """The calibration, where every camera has a lens and a place in the same coordinates."""
    known = set(names) & set(lenses) & set(poses)
    if known != set(names) or len({poses[one].parent_frame_id for one in known}) != 1:
        return None
    return Views({names[one]: _view(path, lenses[one], poses[one]) for one in names}, path.name, "m")


def _view(path: Path, lens: Any, pose: Any) -> View:
    where = f"{path}: {lens.frame_id}"
    if len(lens.K) != 9:
        raise BadInputError(f"{where} has a calibration without K")
    q, at = pose.rotation, pose.translation
    size = lens.width, lens.height
    return view_at(where, lens.K, lens.D, (q.w, q.x, q.y, q.z), (at.x, at.y, at.z), size)


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    try:
        with path.open("rb") as stream:
            yield load_optional("mcap.reader", "export", "MCAP").make_reader(stream)
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error
    except SimulshotError:
        raise
    except Exception as error:  # of a broken file its reader, struct and decompressors raise a dozen kinds
        raise BadInputError(f"{path} is not an intact MCAP: {error}") from error


def _decode(name: str, data: bytes) -> Any:
    errors = load_optional("google.protobuf.message", "export", "MCAP")
    try:
        return message_class(name.partition(".")[2]).FromString(data)
    except errors.DecodeError as error:
        raise ValueError(f"a {name} that cannot be decoded: {error}") from error
