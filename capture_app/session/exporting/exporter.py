"""An exporter is an `Exporter` that an entry point of the group `simulshot.exporters` names, ours included.

It states everything about its format, so that the command, the screen and `export_session` need no table.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_type_hints

from capture_app.common.plugins import load_plugin, load_plugins

GROUP = "simulshot.exporters"
VIDEOS = {"av": "export"}
"""What every exporter needs that writes videos: PyAV."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """The options of every format. A format with more has a subclass of its own; see `Option`."""

    link: bool = False
    """Hard-link image files where possible instead of copying them."""
    lossless: bool = False
    """Write videos and redrawn images without loss."""


@dataclass(frozen=True, slots=True)
class Option:
    """An option of the command that only some formats have: annotates a field of their `ExportOptions`.

    The field is a `bool`, or an `int` from 0 on, a positive `float` or a `Path` that may be None.
    """

    help: str
    metavar: str = ""
    packages: Mapping[str, str] = field(default_factory=dict)
    """Where it is given, these are needed in place of `Exporter.packages`."""


Points = Annotated[Path | None, Option("points to start from, as reconstruct multiview makes", "PLY")]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageOptions(ExportOptions):
    """The options of formats of images that may be masked."""

    instant: Annotated[int | None, Option("one instant only, counted from 0", "N")] = None
    masks: Annotated[Path | None, Option("masks of what moves, as reconstruct movers makes", "DIR")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneOptions(ImageOptions):
    """The options of formats that a scene is reconstructed from."""

    points: Points = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Exporter:
    """A format for `capture-app sessions export --to`: how it is written, and what it needs."""

    write: Callable[..., None]
    """`write(burst, folder)`: write an `ExportedBurst` into an empty folder.

    An exporter with options of its own gets them as a third argument.
    """
    help: str
    """The line in `capture-app sessions export --help`."""
    program: str
    """The program that reads it, as errors and notes name it."""
    options: type[ExportOptions] = ExportOptions
    calibration: Literal["unused", "optional", "required"] = "unused"
    """Whether `burst.calibration` is read. It is checked before `write` begins."""
    uncalibrated: str = ""
    """The note for the user where an optional calibration is missing."""
    unit: str = ""
    """The unit that the program counts lengths in: the user is told where the calibration is in no length."""
    complete_instants: bool = False
    """Whether it needs an instant that every camera has an image of."""
    packages: Mapping[str, str] = field(default_factory=dict)
    """Modules of optional packages, each with simulshot's extra that installs it."""


def load_exporter(name: str) -> Exporter:
    """Import one exporter. Raises BadInputError for an unknown name, NotAvailableError for a broken one."""
    exporter: Exporter = load_plugin(GROUP, name, *_STATED)
    return exporter


def load_exporters() -> dict[str, Exporter]:
    """Import all exporters, by name; a broken one is reported on stderr and skipped."""
    return load_plugins(GROUP, *_STATED)


def own_options(exporter: Exporter) -> dict[str, tuple[type[Any], Option]]:
    """The options of an exporter beside those of every format, by name, each with the type of its value."""
    hints = get_type_hints(exporter.options, include_extras=True)
    annotated = {name: get_args(hint) for name, hint in hints.items() if hasattr(hint, "__metadata__")}
    return {name: ((get_args(kind) or (kind,))[0], option) for name, (kind, option) in annotated.items()}


_STATED = tuple(one.name for one in fields(Exporter))
