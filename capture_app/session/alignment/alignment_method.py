"""Interface of a method that aligns videos without common times: entry points of `simulshot.alignments`.

Each names an `AlignmentMethod`, ours included; its name is a value of `sessions import --align`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Generic, TypeVar

from capture_app.common.plugins import load_plugin, load_plugins
from capture_app.session.format.common_times import CameraTimes

GROUP = "simulshot.alignments"
Track = TypeVar("Track")
"""What a method reads from a video."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignmentMethod(Generic[Track]):
    """Method that finds the offset between two videos in something that both recorded."""

    priority: int
    """Methods are trusted from highest to lowest: a result that contradicts a higher one is not used."""
    of_video_times: bool
    """Whether it needs the times stored in the videos; a given frame rate then excludes it."""
    read: Callable[[Path, float], Track]
    """`read(path, first_s)`: read a video whose first frame has that time, s.

    Raises BadInputError with a short reason if the video lacks what the method needs.
    """
    match: Callable[[Track, Track, float], CameraTimes]
    """`match(reference, camera, sound_error_s)`: return the camera's times against the reference's.

    `sound_error_s` (95 %): possible offset between the cameras' sounds while their images are simultaneous.
    Without an offset, the result has the reason.
    """
    doubt: Callable[[CameraTimes], str] = lambda times: ""
    """Return what else would give this offset, as half a sentence; empty if the result proves itself.

    A result in doubt is taken only if another method agrees with it, or if the user names the method.
    """


def alignment_methods(by: str = "auto") -> Mapping[str, AlignmentMethod[object]]:
    """Import all methods, the most trustworthy first, or the one named; all skips methods that do not load.

    Raises BadInputError if no method has that name, NotAvailableError if it cannot be imported.
    """
    attributes = [field.name for field in fields(AlignmentMethod)]
    if by != "auto":
        return {by: load_plugin(GROUP, by, *attributes)}
    return dict(sorted(load_plugins(GROUP, *attributes).items(), key=lambda item: -item[1].priority))
