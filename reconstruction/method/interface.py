"""Interface of a method: its command, Python, batches and comparisons are derived from it."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import msgspec

from capture_app.common import system
from capture_app.common.plugins import load_plugin, load_plugins
from capture_app.common.text import command_line, pretty_json
from capture_app.console.option_rules import Rule
from capture_app.console.terminal import Progress
from capture_app.session.files.durable import write_atomic
from reconstruction.common.options import CHECKS, METHODS, checked, command_flag, described
from reconstruction.scene.conditions import SYNCHRONIZED, Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.depth.seen_moment import SeenInstant
    from reconstruction.scene.scene import Scene

SILENT = Progress(0, silent=True)
LINES = "lines.txt"
"""Template beside a method's code of the lines that its command prints, of `result`, `out` and `method`."""


class Check(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """What only a comparison makes, and its options there; each field is an option.

    The class is loaded for every `--help`, so its score imports slow modules.
    """

    name: ClassVar[str]
    """Name of the method or check, its plugin, and of a method its command and its method in Python."""
    study: ClassVar[str] = ""
    """Its score in a comparison, as module:class; empty for none."""
    needs: ClassVar[Sequence[str]] = ()
    """Other scores that its score is made from."""


class Method(Check, frozen=True, kw_only=True, dict=True):
    """One way to reconstruct a session, with its options: its words, and how it runs under a condition.

    Each field is an option. The class is loaded for every `--help`, so its methods import slow modules
    themselves.
    """

    help: ClassVar[str]
    """Help of its command."""
    examples: ClassVar[Sequence[str]] = ()
    """Command lines for the help, without `reconstruct`."""
    rules: ClassVar[Sequence[Rule]] = ()
    """Which of its command's options work beside which; what Python refuses, too, is not among them."""
    takes_images: ClassVar[bool] = False
    """Whether image files and folders may take the place of a session."""
    result_file: ClassVar[str] = "metrics.json"
    ours: ClassVar[str] = "reconstruction.common.outputs:OURS"
    """Names of its result's files and folders, which a new result replaces, as module:name."""
    made: ClassVar[str] = "reconstruction.common.outputs:Made"
    """Class of its result in Python, as module:class."""

    instant: Annotated[
        int,
        command_flag("--instant", ge=0, metavar="K", help="Instant of the burst, counted from 0."),
    ] = 0
    time_shifts_ms: Mapping[str, float] = {}
    """Corrections added to the times of the named cameras."""
    progress: Progress = SILENT
    """Receives the lines that say how far it is."""

    def __post_init__(self) -> None:
        """Refuse both `instant` and `instants`, with ValueError, if the method has many of them."""
        if self.instant and self.listed_instants != [self.instant]:
            raise ValueError("give either --instant or --instants")

    @property
    def listed_instants(self) -> Sequence[int]:
        """Its `instants` (empty = all) if it has many and they are given, else `instant` alone."""
        many: Sequence[int] | None = getattr(self, "instants", None)
        return [self.instant] if many is None else many

    def command_line(self, session: Path, condition: Condition, out: str) -> str:
        """Return the command line that writes the results of `run`, in a loop if it takes one instant."""
        flags = {option.field: option for option in described(type(self)) if option.own}
        loop = "instants" not in flags and getattr(self, "instants", None)
        words = ["reconstruct", self.name, str(session)]
        for name, flag in flags.items():
            value = getattr(self, name)
            if value != type(self).__struct_defaults__[type(self).__struct_fields__.index(name)]:
                words += _typed(flag.names[0], value)
        if loop:
            words += ["--instant", "$k"]
        if condition != SYNCHRONIZED:
            words += ["--condition", condition.option]
        words += [*_times_typed(self.time_shifts_ms), "--out", f"{out}/$k" if loop else out]
        line = " ".join(word if "$k" in word else command_line(word) for word in words)
        return f"for k in {' '.join(map(str, loop))}; do {line}; done" if loop else line

    def require(self) -> None:
        """Refuse impossible options before the session is read.

        Raises:
            SimulshotError: a package or device is missing.
        """

    def run(self, scene: "Scene", condition: Condition) -> Iterator[Any]:
        """Yield the result of each of its instants under a condition, in memory; a comparison scores it.

        Raises:
            SimulshotError: the session, the condition or the options do not allow it.
        """
        raise NotImplementedError

    def save(self, scene: "Scene", condition: Condition, output: "OutputFolder") -> Any:
        """Run under a condition, write the result to `output.folder`, and return it without its provenance.

        Raises:
            SimulshotError: the session, the condition or the options do not allow it.
        """
        raise NotImplementedError

    def see(self, scene: "Scene", condition: Condition) -> "Iterator[SeenInstant]":
        """Yield its instants with depth of their cameras, in memory; only methods for depth can.

        Raises:
            SimulshotError: the session, the condition or the options do not allow it.
        """
        raise NotImplementedError

    def notes(self, result: Any) -> Iterator[str]:
        """Yield the messages about a result: cameras that were left out, with the reasons."""
        left_out = getattr(result, "left_out", {})
        yield from (f"{camera} is left out: {why}" for camera, why in left_out.items())

    def lines(self, result: Any, out: Path) -> Iterator[str]:
        """Yield the lines that the command prints of a result, by `LINES` beside the method's code if any."""
        from reconstruction.common.templates import render_lines

        package = sys.modules[type(self).__module__].__package__
        own = files(package) / LINES if package else None
        template = own.read_text("utf-8") if own is not None and own.is_file() else "result: {{ out }}"
        yield from render_lines(template, method=self, result=result, out=out)

    def output_folder(self, out: Path) -> "OutputFolder":
        """Return the folder that replaces an earlier result at `out`, and nothing else."""
        from capture_app.session.files.output_folder import OutputFolder, replaces_only

        return OutputFolder(out, replaces_only(resolve_name(self.ours) | {self.result_file}))

    def make(self, sources: "Sequence[Path | Scene]", out: Path, condition: Condition = SYNCHRONIZED) -> Any:
        """Check the options, and write the result of a session, or of images, to `out`; see `write`."""
        return checked(self).write(sources, out, condition)

    def write(self, sources: "Sequence[Path | Scene]", out: Path, condition: Condition) -> Any:
        """Run on a session, or on images; write the result to `out` atomically, and return it.

        Raises:
            SimulshotError: the sources, the condition, the options or the folder cannot be used.
        """
        from reconstruction.scene.provenance import with_provenance

        began_s = system.monotonic_s()
        output = self.output_folder(out)
        self.require()
        with output:
            result = self.compute(sources, condition, output)
            result = with_provenance(result, began_s, self.time_shifts_ms)
            write_atomic(output.folder / self.result_file, pretty_json(result))
        return result

    def compute(self, sources: "Sequence[Path | Scene]", condition: Condition, output: "OutputFolder") -> Any:
        """Open the session and run on it; a method that takes images overrides this."""
        scene = self.open_scene(sources[0])
        result = self.save(scene, condition.named(scene.dataset), output)
        return msgspec.structs.replace(result, labels=scene.dataset.other_labels)

    def open_scene(self, session: "Path | Scene") -> "Scene":
        """Open the session that it runs on, unless it is open.

        Raises:
            SimulshotError: the session or its calibration cannot be used.
        """
        from reconstruction.scene.scene import Scene

        return session if isinstance(session, Scene) else Scene.open(session, self.time_shifts_ms)


def _typed(names: str, value: Any) -> list[str]:
    """Return how an option with these names is typed."""
    name, _, negative = names.partition("/")
    if isinstance(value, bool):
        return [name] if value else [negative] if negative else []
    text = ",".join(map(str, value)) or "all" if isinstance(value, tuple) else str(value)
    return [name, text]


def _times_typed(time_shifts_ms: Mapping[str, float]) -> list[str]:
    return [word for name, ms in time_shifts_ms.items() for word in ("--time-shift-ms", f"{name}={ms:g}")]


@cache
def methods() -> Mapping[str, type[Method]]:
    """Return all installed methods by name; broken plugins are reported once and left out."""
    return load_plugins(METHODS, "name", "study", "help", "make")


@cache
def scored() -> Sequence[type[Check]]:
    """Return all methods and checks that are parts of a comparison."""
    checks: Mapping[str, type[Check]] = load_plugins(CHECKS, "name", "study")
    return [kind for kind in (*methods().values(), *checks.values()) if kind.study]


def study_names() -> list[str]:
    """Return the names of all scores that a comparison can make, without loading them."""
    return sorted(kind.name for kind in scored())


def find_method(name: str, **options: Any) -> Method:
    """Return an installed method with its options.

    Raises:
        BadInputError: it is not installed.
        NotAvailableError: it cannot be loaded.
    """
    method: Method = load_plugin(METHODS, name, "make")(**options)
    return method
