"""Search for clips in an arbitrary folder, grouped into takes by names, folders and dates.

Dates are the `creation_time` that cameras write into their videos. Camera clocks are often wrong, so dates
separate clips only if each group then has several, or if a lone clip also has a very different length. Each
folder is one camera, unless clips in one of them overlap in time or its name says that it is a take.
"""

import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from itertools import combinations, product, zip_longest
from pathlib import Path
from statistics import median

from capture_app.common.errors import BadInputError
from capture_app.common.names import name_like, natural_order
from capture_app.common.text import Talk, count
from capture_app.session.importing.clip_pairs import Clip, Heard, Key, is_counted, pair_clips, take_keys
from capture_app.session.importing.folder_tree import folders_below
from capture_app.session.importing.importer import load_importers
from capture_app.session.importing.recording_sources import videos_in
from capture_app.session.importing.video_tracks import open_container

_CAMERA = re.compile(
    r"cam|left|right|front|back|side|top|view|gopro|phone|pixel|ipad|galaxy|canon|sony|angle"
)
_TAKE = re.compile(r"take|trial|run|scene|shot|day|session|try|attempt|walk|jump|20\d\d")
_CALIBRATION = re.compile(r"calib|intrinsic|extrinsic|board|checker|charuco", re.IGNORECASE)
_MAX_LENGTH_RATIO = 2.0
"""Maximum ratio of the lengths of two clips of one take."""


Shoot = tuple[str, Mapping[str, Clip]]
"""Name and clips, by camera, of one take; the name is empty if the folder has only this take."""


def find_shoots(
    folder: Path, talk: Talk = lambda said: None, heard: Heard = lambda one, other: False
) -> tuple[list[Shoot], list[str]]:
    """Return the takes in a folder, and lines about what was left out and why.

    `talk` receives what the takes assume of the cameras' clocks; `heard` decides where these allow two takes.
    There are none if neither the folder nor its subfolders contain videos.
    """
    shoots: list[Shoot] = []
    left_out: list[str] = []
    own = _usable(videos_in(folder), left_out)
    inner = {path: clips for path in sorted(folder.iterdir()) if (clips := _clips_below(path, left_out))}
    for path, clips in inner.items():
        of_boards = [clip for clip in clips if _CALIBRATION.search(str(clip.path.parent.relative_to(path)))]
        if 0 < len(of_boards) < len(clips):
            inner[path] = [clip for clip in clips if clip not in of_boards]
            left_out.append(
                f"{path.name}: {count(len(of_boards), 'clip')} that look like calibration; "
                "reconstruct calibrate takes them"
            )
    boards = [path for path in inner if _CALIBRATION.search(path.name)]
    for path in boards if len(inner) > len(boards) or own else ():
        left_out.append(f"{path.name}: looks like calibration; reconstruct calibrate takes it")
        del inner[path]
    if len(inner) == 1 and not own:
        # Unreadable files there were reported already, when its clips were searched.
        shoots, deeper = find_shoots(next(iter(inner)), talk, heard)
        return shoots, [*(line for line in left_out if line not in deeper), *deeper]
    if len(own) >= max(1, len(inner)):
        left_out += [f"{path.name}: {count(len(clips), 'clip')} beside" for path, clips in inner.items()]
        shoots = _of_one_folder(own, left_out, talk, heard)
    elif inner:
        left_out += [f"{clip.path.name}: beside the cameras' folders" for clip in own]
        shoots = _of_folders(inner, left_out, talk, heard)
    return shoots, left_out


def find_calibration(folder: Path) -> Path | None:
    """Return a calibration in a folder, or in a subfolder with a name for calibrations."""
    inner = [path for path in sorted(folder.iterdir()) if path.is_dir() and _CALIBRATION.search(path.name)]
    for place, importer in product((folder, *inner), load_importers()):
        for pattern in importer.calibration_files:
            if (file := min(place.glob(pattern), default=None)) is not None:
                return place if importer.calibration_per_camera else file
    return None


def _usable(paths: Sequence[Path], left_out: list[str]) -> list[Clip]:
    clips = []
    for path in sorted(paths, key=lambda path: natural_order(path.name)):
        if not path.name.startswith("."):
            try:
                clips.append(_read(path))
            except BadInputError as error:
                left_out.append(f"{path.name}: {error.what}")
    return clips


def _read(path: Path) -> Clip:
    with open_container(path) as (_, container):
        if not container.streams.video or next(container.decode(video=0), None) is None:
            raise BadInputError("it has no pictures")
        stream = container.streams.video[0]
        seconds = float(stream.duration * stream.time_base) if stream.duration else 0.0
        dates = [_date_s(holder.metadata.get("creation_time", "")) for holder in (container, stream)]
    # Zero in QuickTime's dates, 1904, means that there is no date.
    return Clip(path, seconds, next((date_s for date_s in dates if date_s > 0), None))


def _date_s(text: str) -> float:
    """Parse a date to seconds since 1970; 0 if it is missing or in a format that no camera writes."""
    try:
        return datetime.fromisoformat(text).timestamp()
    except ValueError:
        return 0.0


def _clips_below(folder: Path, left_out: list[str]) -> list[Clip]:
    return [clip for place in folders_below(folder) for clip in _usable(videos_in(place), left_out)]


def _of_one_folder(clips: list[Clip], left_out: list[str], talk: Talk, heard: Heard) -> list[Shoot]:
    """Group the clips of one folder into takes, and add to `left_out` why a clip was left out.

    Group them by recording time if that gives several takes, otherwise by names such as cam1_take2. If
    neither works, all clips are one take.
    """
    groups = _by_date(clips)
    several = [group for group in groups if len(group) > 1]
    dated = all(clip.began_s is not None for clip in clips)
    if several and len(several) < len(groups) and dated and (cameras := _by_counters(clips)):
        return _of_cameras(cameras, left_out, talk, heard)
    if len(several) > 1 and dated:
        left_out += [
            f"{clip.path.name}: by its date, nothing was taken with it"
            for clip, *others in groups
            if not others
        ]
        return [_shoot(f"{number}", group) for number, group in enumerate(several, 1)]
    if len(several) == 1:
        typical_s = median(clip.seconds for clip in several[0])
        for clip in (group[0] for group in groups if len(group) == 1):
            longer = max(clip.seconds, typical_s) > _MAX_LENGTH_RATIO * min(clip.seconds, typical_s)
            if clip.began_s is not None and longer:
                left_out.append(f"{clip.path.name}: of another date and another length")
                clips = [other for other in clips if other is not clip]
    return _by_names(clips, left_out) or [_shoot("", clips)]


def _by_date(clips: Sequence[Clip]) -> list[list[Clip]]:
    groups: list[list[Clip]] = []
    for clip in sorted(clips, key=lambda clip: clip.began_s or 0.0):
        if groups and any(clip.together(other) for other in groups[-1]):
            groups[-1].append(clip)
        else:
            groups.append([clip])
    return groups


def _by_counters(clips: Sequence[Clip]) -> dict[str, list[Clip]]:
    """Return the clips by the word before the number that their camera counts; none if it is one word."""
    words = {clip: re.sub(r"[_\-. ]*\d+$", "", clip.path.stem) for clip in clips}
    cameras = {
        name_like(word, "cam"): [clip for clip in clips if words[clip] == word] for word in words.values()
    }
    counted = all(clip.path.stem[-1].isdecimal() for clip in clips)
    return cameras if counted and min(map(len, cameras.values())) > 1 < len(cameras) else {}


def _by_names(clips: Sequence[Clip], left_out: list[str]) -> list[Shoot]:
    """Group clips whose two-part names form a grid of cameras and takes; none if they do not.

    A grid with gaps must have one part that names takes, and one take of all cameras.
    """
    words = [tuple(re.split(r"[\s_\-.]+", clip.path.stem)) for clip in clips]
    varying = [k for k, column in enumerate(zip_longest(*words)) if len(set(column)) > 1]
    if len({len(own_words) for own_words in words}) != 1 or len(varying) != 2:
        return []
    grid = {
        (own_words[varying[0]], own_words[varying[1]]): clip
        for own_words, clip in zip(words, clips, strict=True)
    }
    parts = [sorted({pair[k] for pair in grid}, key=natural_order) for k in (0, 1)]
    named = [_are_takes(part) for part in parts]
    takes = 0 if named[0] and not named[1] else 1
    shoots: list[Shoot] = [
        (
            take,
            {name_like(pair[1 - takes], "cam"): clip for pair, clip in grid.items() if pair[takes] == take},
        )
        for take in parts[takes]
    ]
    whole = any(len(shoot) == len(parts[1 - takes]) for _, shoot in shoots)
    gaps = len(clips) < len(parts[0]) * len(parts[1])
    if len(grid) < len(clips) or (gaps and (named[0] == named[1] or not whole)):
        return []
    left_out += [
        f"{clip.path.name}: nothing was taken with it"
        for _, shoot in shoots
        for clip in shoot.values()
        if len(shoot) < 2 < len(clips)
    ]
    return [(take, shoot) for take, shoot in shoots if len(shoot) > 1] or shoots


def _are_takes(names: Sequence[str]) -> bool:
    text = " ".join(names).lower()
    return _TAKE.search(text) is not None and _CAMERA.search(text) is None


def _of_folders(
    inner: Mapping[Path, list[Clip]], left_out: list[str], talk: Talk, heard: Heard
) -> list[Shoot]:
    within = any(first.together(other) for clips in inner.values() for first, other in combinations(clips, 2))
    stems = {clip.path.stem for clips in inner.values() for clip in clips}
    named = _are_takes([path.name for path in inner]) or (
        _CAMERA.search(" ".join(stems).lower()) is not None
        and _CAMERA.search(" ".join(path.name for path in inner).lower()) is None
    )
    if within or (named and all(len(clips) > 1 for clips in inner.values())):
        return [_shoot(path.name, clips) for path, clips in inner.items()]
    cameras = {name_like(path.name, f"cam{n}"): clips for n, (path, clips) in enumerate(inner.items())}
    if all(len(clips) == 1 for clips in cameras.values()):
        return [("", {name: clips[0] for name, clips in cameras.items()})]
    return _of_cameras(cameras, left_out, talk, heard)


def _of_cameras(
    cameras: Mapping[str, Sequence[Clip]], left_out: list[str], talk: Talk, heard: Heard
) -> list[Shoot]:
    """Group the clips of cameras into takes with the camera that has the most."""
    first = max(cameras, key=lambda name: len(cameras[name]))
    keys = take_keys(cameras)
    takes = {clip: {first: clip} for clip in cameras[first]}
    for name, clips in cameras.items():
        if name != first:
            pairs, note = pair_clips((first, name), cameras[first], clips, heard, keys)
            for one, other in pairs:
                takes[one][name] = other
            if note:
                talk(note)
    paired = {clip for take in takes.values() if len(take) > 1 for clip in take.values()}
    # Takes that the camera with the most clips lacks.
    rest: dict[Key, dict[str, Clip]] = {}
    for name, clips in cameras.items():
        for clip in clips:
            if clip not in paired and not is_counted(clip):
                rest.setdefault(keys[clip], {})[name] = clip
    several = [take for take in (*takes.values(), *rest.values()) if len(take) > 1]
    shoots: list[Shoot] = [
        (f"{number}" if len(several) > 1 else "", {name: take[name] for name in cameras if name in take})
        for number, take in enumerate(several, 1)
    ]
    taken = {clip.path for _, shoot in shoots for clip in shoot.values()}
    left = [clip for clips in cameras.values() for clip in clips if clip.path not in taken]
    left_out += [f"{clip.path.parent.name}/{clip.path.name}: nothing was taken with it" for clip in left]
    return shoots


def _shoot(name: str, clips: Sequence[Clip]) -> Shoot:
    names = [name_like(clip.path.stem, f"cam{number}") for number, clip in enumerate(clips)]
    unique = [own if names.count(own) == 1 else f"{own}-{n}" for n, own in enumerate(names)]
    return name_like(name, ""), dict(zip(unique, clips, strict=True))
