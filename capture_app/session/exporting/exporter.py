"""Exporter interface: each entry point of the group `simulshot.exporters` names an `Exporter`.

Built-in formats are entry points, too. An exporter declares everything about its format, so the command, the
screen and `export_session` need no table.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_type_hints

from capture_app.common.optional_packages import how_to_install, is_here
from capture_app.common.plugins import load_plugin, load_plugins

GROUP = "simulshot.exporters"
VIDEOS = {"av": "export"}
"""Requirement of every exporter that writes videos: PyAV."""


@dataclass(frozen=True, slots=True)
class Option:
    """Command-line option of some formats only; annotates a keyword-only parameter of their `Exporter.write`.

    The parameter is a `bool`, a non-negative `int`, or, perhaps None, a positive `float`, a `Path` or one of
    `choices`.
    """

    help: str
    metavar: str = ""
    choices: tuple[str, ...] = ()
    packages: Mapping[str, str] = field(default_factory=dict)
    """Packages that the option requires, in place of `Exporter.packages`."""


Points = Annotated[Path | None, Option("points to start from, as reconstruct multiview makes", "PLY")]


Masks = Annotated[Path | None, Option("masks of what moves, as reconstruct movers makes", "DIR")]
_INSTANT = Option("one instant only, counted from 0", "N")


@dataclass(frozen=True, slots=True, kw_only=True)
class Exporter:
    """A format for `capture-app sessions export --to`: its writer and its requirements."""

    write: Callable[..., None]
    """`write(burst, folder)`: write an `ExportedBurst` into an empty folder.

    A keyword-only parameter with a default, annotated with an `Option`, is an option of the format.
    """
    help: str
    """Its line in `capture-app sessions export --help`."""
    program: str
    """Name of the program that reads the format, for errors and notes."""
    calibration: Literal["unused", "optional", "required"] = "unused"
    """Whether `burst.calibration` is read. It is checked before `write` is called."""
    uncalibrated: str = ""
    """Note for the user if an optional calibration is missing."""
    fisheyes: bool = False
    """Whether it can have fisheyes, as they are or redrawn for perspective lenses."""
    unit: str = ""
    """The program's unit of length; the user gets a note if the calibration's unit is not a length."""
    one_instant: bool = False
    """Whether it has the option `instant`; the burst then has the images of that instant alone."""
    complete_instants: bool = False
    """Whether it needs at least one instant for which every camera has an image."""
    packages: Mapping[str, str] = field(default_factory=dict)
    """Modules of optional packages, each with the simulshot extra that installs it."""


def load_exporter(name: str) -> Exporter:
    """Import one exporter. Raises BadInputError if it is unknown, NotAvailableError if its import fails."""
    exporter: Exporter = load_plugin(GROUP, name, *_STATED)
    return exporter


def load_exporters() -> dict[str, Exporter]:
    """Import all exporters, by name; one that fails is reported on stderr and skipped."""
    return load_plugins(GROUP, *_STATED)


def unmet_needs(exporter: Exporter, *, calibrated: bool) -> dict[str, str]:
    """Return what an export needs that is not here, and how to get each; `calibrated`: the session is."""
    extras = dict.fromkeys(extra for module, extra in exporter.packages.items() if not is_here(module))
    needs = {"packages": "; ".join(map(how_to_install, extras))} if extras else {}
    if exporter.calibration == "required" and not calibrated:
        needs["a calibration"] = "reconstruct calibrate makes one"
    return needs


def own_options(exporter: Exporter) -> dict[str, tuple[type[Any], Option]]:
    """Return an exporter's options beyond the common ones, by name, each with its value type."""
    own: dict[str, tuple[type[Any], Option]] = {"instant": (int, _INSTANT)} if exporter.one_instant else {}
    # The hints of a writer without options may name what its module imports for type checkers alone.
    names = getattr(exporter.write, "__kwdefaults__", None) or ()
    hints = get_type_hints(exporter.write, include_extras=True) if names else {}
    for name in names:
        kind, option = get_args(hints[name])
        own[name] = ((get_args(kind) or (kind,))[0], option)
    return own


_STATED = tuple(field.name for field in fields(Exporter))
