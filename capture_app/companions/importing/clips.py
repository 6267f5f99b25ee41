"""Search for clips in an arbitrary folder, grouped into takes by names, folders and dates.

Dates are the `creation_time` that cameras write into their videos. Camera clocks are often wrong, so dates
separate clips only if each group then has several, or if a lone clip also has a very different length. Each
folder is one camera, unless clips in one of them overlap in time or its name says that it is a take.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from itertools import chain, combinations, pairwise
from pathlib import Path
from statistics import median

from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.common.names import label_of, natural_order
from capture_app.common.text import count
from capture_app.session.alignment.alignment_method import alignment_methods
from capture_app.session.importing.importer import CALIBRATION
from capture_app.session.importing.name_roles import CAMERA, TAKE, choose, parse_names, take_names
from capture_app.session.importing.recording_sources import (
    clip_span,
    folders_below,
    later_chapters,
    videos_in,
)
from capture_app.session.importing.video_tracks import open_container

_SLACK_S = 2.0
_HEARD_PAIRS = 3
"""Number of pairs of each pairing that are compared by sound."""
_COUNTER = re.compile(r"(?!take|run)[A-Za-z]{0,4}_?\d{3,}", re.IGNORECASE)
"""A name that cameras count, such as IMG_0001 or C0017: equal ones of two cameras mean nothing."""


@dataclass(frozen=True, slots=True)
class Clip:
    """A video: its length, and its start by its camera's clock, s; the start is None if unknown."""

    path: Path
    seconds: float
    began_s: float | None

    def overlaps(self, other: "Clip") -> bool:
        """Return whether both were recorded at the same time by their dates, which are whole seconds.

        A clip that begins where another ends is a later one.
        """
        if self.began_s is None or other.began_s is None:
            return False
        first, second = sorted((self, other), key=lambda clip: clip.began_s or 0.0)
        return (second.began_s or 0.0) - (first.began_s or 0.0) <= max(first.seconds - _SLACK_S, _SLACK_S)


Pairs = tuple[tuple[Clip, Clip], ...]
Heard = Callable[[Path, Path], bool]
"""Returns whether two videos recorded the same sound."""


def is_counted(clip: Clip) -> bool:
    """Return whether a clip's name is one that cameras count, which says nothing of another camera's."""
    return _COUNTER.fullmatch(clip.path.stem) is not None


def pair_clips(
    names: tuple[str, str],
    first: Sequence[Clip],
    clips: Sequence[Clip],
    heard: Heard,
    takes: Mapping[Path, str],
) -> tuple[Pairs, str]:
    """Return the clips of two cameras that belong together, and what this assumes; empty if nothing.

    `names` are the cameras'. Clips of both are in the order of their names. `takes` are their `take_names`.
    """
    named = tuple((clip, other) for clip in first for other in clips if takes[clip.path] == takes[other.path])
    counted = all(is_counted(clip) for clip, _ in named)
    if len(named) == min(len(first), len(clips)) and not counted:
        return named, ""
    if all(clip.began_s is not None for clip in (*first, *clips)):
        dated, note = _by_clocks(names, first, clips, heard)
        taken = {clip for pair in named for clip in pair if not counted}
        return (*(() if counted else named), *(pair for pair in dated if taken.isdisjoint(pair))), note
    if named or len(first) != len(clips):
        return named, ""
    by_order = tuple(zip(first, clips, strict=True))
    several = len(first) > 1
    return by_order, f"the clips of {' and '.join(names)} are paired by their order" if several else ""


def _by_clocks(
    names: tuple[str, str], first: Sequence[Clip], clips: Sequence[Clip], heard: Heard
) -> tuple[Pairs, str]:
    """Pair clips by their dates, or by a constant difference of the clocks that pairs all of them."""
    min_count = min(len(first), len(clips))
    straight = _at_difference(first, clips, 0.0)
    # A difference that pairs all clips pairs the first one of the camera with fewer.
    anchor = min(first, clips, key=len)[0]
    pairs = ((clip, other) for clip in first for other in clips if anchor in (clip, other))
    later_s = sorted(
        ((other.began_s or 0.0) - (first_clip.began_s or 0.0) for first_clip, other in pairs), key=abs
    )
    shifted = {tuple(_at_difference(first, clips, by_s)): by_s for by_s in reversed(later_s)}
    complete = {pairs: by_s for pairs, by_s in shifted.items() if len(pairs) == min_count}
    if len(straight) == min_count or not complete:
        return straight, ""
    possible = {**complete, **({straight: 0.0} if straight else {})}
    scores = {
        pairs: sum(heard(first_clip.path, other.path) for first_clip, other in pairs[:_HEARD_PAIRS])
        for pairs in (possible if len(possible) > 1 else ())
    }
    leading = [pairs for pairs, score in scores.items() if score == max(scores.values()) > 0]
    is_heard, likeliest = len(leading) == 1, straight if len(complete) > 1 else next(iter(complete))
    chosen = leading[0] if is_heard else likeliest
    by_s = possible.get(chosen) or min(complete.values(), key=abs)
    by, apart = "sound" if is_heard else "dates alone", timedelta(seconds=round(abs(by_s)))
    if chosen == straight:
        return (
            chosen,
            f"by their {by}, {' and '.join(names)} have equal clocks, and do not differ by {apart} h",
        )
    ahead, behind = names[::-1] if by_s > 0 else names
    sure = "; otherwise each missed a take" if straight and not is_heard else ""
    return (
        chosen,
        f"by their {by}, the clock of {ahead} is {apart} h ahead of that of {behind} in all takes{sure}",
    )


def _at_difference(first: Sequence[Clip], clips: Sequence[Clip], later_s: float) -> Pairs:
    """Return the clips that were recorded together if the second camera's clock is `later_s` ahead."""
    pairs: list[tuple[Clip, Clip]] = []
    left = list(clips)
    for clip in first:
        at = replace(clip, began_s=(clip.began_s or 0.0) + later_s)
        if (other := next(filter(at.overlaps, left), None)) is not None:
            pairs.append((clip, other))
            left.remove(other)
    return tuple(pairs)


_PROXY = re.compile(r"(^|/)(SUB/|prox(y|ies)/|GL\d{6}\.|LRV_)|_proxy\.", re.IGNORECASE)
"""Paths of small copies that cameras and editors write: Sony, GoPro, Insta360, DaVinci Resolve."""
_MAX_LENGTH_RATIO = 2.0
"""Maximum ratio of the lengths of two clips of one take."""


Shoot = tuple[str, Mapping[str, Clip]]
"""Name and clips, by camera, of one take; the name is empty if the folder has only this take."""


def find_shoots(folder: Path) -> tuple[list[Shoot], list[str]]:
    """Return the takes in a folder, and lines about what was left out and why, and what they assume.

    There are none if neither the folder nor its subfolders contain videos.
    """
    shoots: list[Shoot] = []
    notes: list[str] = []
    own = _usable(videos_in(folder), notes, folder)
    below = {path: clips for path in sorted(folder.iterdir()) if (clips := _clips_below(path, notes, folder))}
    films = {path: [clip for clip in clips if not _of_board(clip, folder)] for path, clips in below.items()}
    inner = {path: clips for path, clips in films.items() if clips} if own or any(films.values()) else below
    notes += [
        f"left out {path.name}: {count(boards, 'clip')} that look like calibration; "
        "reconstruct calibrate takes them"
        for path, clips in below.items()
        if (boards := len(clips) - len(inner.get(path, ())))
    ]
    if len(inner) == 1 and not own:
        # Unreadable files there were reported already, when its clips were searched.
        shoots, deeper = find_shoots(next(iter(inner)))
        return shoots, [*(line for line in notes if line not in deeper), *deeper]
    if len(own) >= max(1, len(inner)):
        notes += [
            f"left out {path.name}: {count(len(clips), 'clip')} beside" for path, clips in inner.items()
        ]
        shoots = _of_one_folder(own, notes)
    elif inner:
        notes += [f"left out {clip.path.name}: beside the cameras' folders" for clip in own]
        shoots = _of_folders(inner, notes)
    return shoots, notes


def _of_board(clip: Clip, root: Path) -> bool:
    return CALIBRATION.search(str(clip.path.parent.relative_to(root))) is not None


def _usable(paths: Sequence[Path], notes: list[str], root: Path) -> list[Clip]:
    clips = []
    for path in sorted(paths, key=lambda path: natural_order(path.name)):
        if _PROXY.search(inside := path.relative_to(root).as_posix()):
            notes.append(f"left out {inside}: a small copy, by its name; NAME=PATH imports it")
        elif not path.name.startswith("."):
            try:
                clips.append(_read(path))
            except BadInputError as error:
                notes.append(f"left out {path.name}: {error.what}")
    return clips


def _read(path: Path) -> Clip:
    with open_container(path) as (_, container):
        if not container.streams.video or next(container.decode(video=0), None) is None:
            raise BadInputError("it has no pictures")
    spans = [clip_span(part) for part in (path, *later_chapters(path))]
    return Clip(path, sum(seconds for _, seconds in spans), spans[0][0])


def _clips_below(folder: Path, notes: list[str], root: Path) -> list[Clip]:
    return [clip for place in folders_below(folder) for clip in _usable(videos_in(place), notes, root)]


def _of_one_folder(clips: list[Clip], notes: list[str]) -> list[Shoot]:
    """Group the clips of one folder into takes, and add to `notes` why a clip was left out.

    Group them by names such as cam1_take2, otherwise by recording time if that gives several takes. If
    neither works, all clips are one take.
    """
    if shoots := _by_names(clips, clips[0].path.parent, notes):
        return shoots
    groups = _by_date(clips)
    several = [group for group in groups if len(group) > 1]
    if len(several) > 1 and all(clip.began_s is not None for clip in clips):
        notes += [
            f"left out {clip.path.name}: by its date, nothing was taken with it"
            for clip, *others in groups
            if not others
        ]
        return [_shoot(f"{number}", group) for number, group in enumerate(several, 1)]
    words = {re.sub(r"[\W_]*\d+", "", clip.path.stem) for clip in clips}
    in_order = all((one.began_s or 0.0) < (other.began_s or 0.0) for one, other in pairwise(clips))
    if (
        len(clips) > 1 > len(several)
        and in_order
        and len(words) == 1
        and all(map(is_counted, clips))
        and clips[0].began_s
    ):
        notes.append("by their counters and dates, these clips are of one camera")
        camera = label_of(words.pop())
        return [(label_of(clip.path.stem), {camera: clip}) for clip in clips]
    if len(several) == 1:
        typical_s = median(clip.seconds for clip in several[0])
        for clip in (group[0] for group in groups if len(group) == 1):
            longer = max(clip.seconds, typical_s) > _MAX_LENGTH_RATIO * min(clip.seconds, typical_s)
            if clip.began_s is not None and longer:
                notes.append(f"left out {clip.path.name}: of another date and another length")
                clips = [other for other in clips if other is not clip]
    return _by_names(clips, clips[0].path.parent, notes) or [_shoot("", clips)]


def _by_date(clips: Sequence[Clip]) -> list[list[Clip]]:
    groups: list[list[Clip]] = []
    for clip in sorted(clips, key=lambda clip: clip.began_s or 0.0):
        if groups and any(clip.overlaps(other) for other in groups[-1]):
            groups[-1].append(clip)
        else:
            groups.append([clip])
    return groups


def _by_names(clips: Sequence[Clip], root: Path, notes: list[str]) -> list[Shoot]:
    """Group clips into takes of the cameras that their names show, below a folder; none if they do not."""
    parse = choose(parse_names([clip.path for clip in clips], root, stills=False))
    if parse is None or len(parse.takes) < 2:
        return []
    of = {clip.path: clip for clip in clips}
    cameras = {label_of(name): [of[file] for file in files] for name, files in parse.cameras.items()}
    return _of_cameras(cameras, notes)


def _of_folders(inner: Mapping[Path, list[Clip]], notes: list[str]) -> list[Shoot]:
    """Group the clips of folders, each of which is a take or a camera."""
    named = any(TAKE.search(path.name) for path in inner) and not any(
        CAMERA.search(path.name) for path in inner
    )
    within = any(first.overlaps(other) for clips in inner.values() for first, other in combinations(clips, 2))
    if shoots := _by_names([*chain.from_iterable(inner.values())], next(iter(inner)).parent, notes):
        return shoots
    if within or (named and all(len(clips) > 1 for clips in inner.values())):
        return [_shoot(path.name, clips) for path, clips in inner.items()]
    cameras = {label_of(path.name): clips for path, clips in inner.items()}
    if all(len(clips) == 1 for clips in cameras.values()):
        return [("", {name: clips[0] for name, clips in cameras.items()})]
    return _of_cameras(cameras, notes)


def _of_cameras(cameras: Mapping[str, Sequence[Clip]], notes: list[str]) -> list[Shoot]:
    """Group the clips of cameras into takes with the camera that has the most."""
    first = max(cameras, key=lambda name: len(cameras[name]))
    names = take_names({name: [clip.path for clip in clips] for name, clips in cameras.items()})
    takes = {clip: {first: clip} for clip in cameras[first]}
    for name, clips in cameras.items():
        if name != first:
            pairs, note = pair_clips((first, name), cameras[first], clips, heard_together, names)
            for one, other in pairs:
                takes[one][name] = other
            notes += filter(None, [note])
    paired = {clip for take in takes.values() if len(take) > 1 for clip in take.values()}
    # Takes that the camera with the most clips lacks.
    rest: dict[str, dict[str, Clip]] = {}
    for name, clips in cameras.items():
        for clip in clips:
            if clip not in paired and not is_counted(clip):
                rest.setdefault(names[clip.path], {})[name] = clip
    several = [take for take in (*takes.values(), *rest.values()) if len(take) > 1]
    shoots: list[Shoot] = []
    for number, take in enumerate(several, 1):
        called = {names[clip.path] for clip in take.values()}
        own = label_of(called.pop()) if len(called) == 1 else ""
        shoots.append(
            (
                own or f"{number}" if len(several) > 1 else "",
                {name: take[name] for name in cameras if name in take},
            )
        )
    taken = {clip.path for _, shoot in shoots for clip in shoot.values()}
    left = [clip for clips in cameras.values() for clip in clips if clip.path not in taken]
    notes += [
        f"left out {clip.path.parent.name}/{clip.path.name}: nothing was taken with it" for clip in left
    ]
    return shoots


def _shoot(name: str, clips: Sequence[Clip]) -> Shoot:
    names = [label_of(clip.path.stem) for clip in clips]
    unique = [own if names.count(own) == 1 else f"{own}-{n}" for n, own in enumerate(names)]
    return label_of(name), dict(zip(unique, clips, strict=True))


def heard_together(one: Path, other: Path) -> bool:
    """Return whether two videos have the same sound, at any offset; False without the method `sound`."""
    try:
        (method,) = alignment_methods("sound").values()
        return method.match(method.read(one, 0.0), method.read(other, 0.0), 0.0).offset_ns is not None
    except (BadInputError, NotAvailableError):
        return False
