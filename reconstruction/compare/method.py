"""Interface of a method: its command, Python, batches and comparisons are derived from it."""

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from capture_app.common.plugins import load_plugin, load_plugins, plugin_names
from capture_app.common.text import pretty_json
from capture_app.console.terminal import Progress
from capture_app.session.files.durable import write_atomic
from reconstruction.common.options import METHODS, STUDIES, MethodOptions, checked
from reconstruction.session.conditions import SYNCHRONIZED, Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.session.dataset import Dataset


class Method:
    """One way to reconstruct a session: its options, how it runs under a condition, and its words.

    The class is loaded for every `--help`, so its methods import slow modules themselves.
    """

    name: ClassVar[str]
    """Name of the method, its command, its method in Python and its plugin."""
    Options: ClassVar[type[msgspec.Struct]] = MethodOptions
    """Struct of all its options; one that runs extends `MethodOptions`."""
    study: ClassVar[str] = ""
    """The study that scores it in a comparison, as module:class; empty for none."""
    help: ClassVar[str] = ""
    """Help of its command; empty: it has no command, and is only a part of comparisons."""
    examples: ClassVar[Sequence[str]] = ()
    """Command lines for the help, without `reconstruct`."""
    aliases: ClassVar[Sequence[str]] = ()
    """Earlier names of its command."""
    takes_images: ClassVar[bool] = False
    """Whether image files and folders may take the place of a session."""
    result_file: ClassVar[str] = "metrics.json"
    made: ClassVar[str] = "reconstruction.common.outputs:Made"
    """Class of its result in Python, as module:class."""

    def __init__(self, options: Any = None, progress: Progress | None = None) -> None:
        """Create the method with its options, checked.

        Raises:
            BadInputError: an option is outside its bounds, or of the wrong type.
        """
        self.options: Any = checked(self.Options() if options is None else options)
        self.progress = progress or Progress(0, silent=True)

    def check(self) -> None:
        """Refuse impossible options before the session is read.

        Raises:
            SimulshotError: a package or device is missing.
        """

    def run(self, dataset: "Dataset", condition: Condition, output: "OutputFolder") -> Any:
        """Reconstruct under a condition into `output.folder`, and return the result without its provenance.

        Raises:
            SimulshotError: the session, the condition or the options do not allow it.
        """
        raise NotImplementedError

    def notes(self, result: Any) -> Iterator[str]:
        """Yield the messages about a result: cameras that were left out, with the reasons."""
        left_out = getattr(result, "left_out", {})
        yield from (f"{camera} is left out: {why}" for camera, why in left_out.items())

    def lines(self, result: Any, out: Path) -> Iterator[str]:
        """Yield the lines that the command prints of a result."""
        yield f"result: {out}"

    def output_folder(self, out: Path) -> "OutputFolder":
        """Return the folder that replaces an earlier result at `out`, and nothing else."""
        from reconstruction.common.outputs import comparison_folder

        return comparison_folder(out)

    def make(self, sources: Sequence[Path], out: Path, condition: Condition = SYNCHRONIZED) -> Any:
        """Run on a session, or on images; write the result to `out` atomically, and return it.

        Raises:
            SimulshotError: the sources, the condition, the options or the folder cannot be used.
        """
        from reconstruction.session.provenance import with_provenance

        began_s = time.monotonic()
        output = self.output_folder(out)
        self.check()
        with output:
            result = self.compute(sources, condition, output)
            result = with_provenance(result, began_s, self.options.time_shifts_ms)
            write_atomic(output.folder / self.result_file, pretty_json(result))
        return result

    def compute(self, sources: Sequence[Path], condition: Condition, output: "OutputFolder") -> Any:
        """Open the session and run on it; a method that takes images overrides this."""
        from reconstruction.calibration.stored import choose_calibration
        from reconstruction.session.dataset import Dataset

        dataset = Dataset.open(sources[0], self.options.time_shifts_ms)
        condition.check(dataset)
        choose_calibration(dataset)
        return self.run(dataset, condition, output)


@cache
def methods() -> Mapping[str, type[Method]]:
    """Return all installed methods by name; broken plugins are reported once and left out."""
    return load_plugins(METHODS, "name", "Options", "study", "help")


def study_names() -> list[str]:
    """Return the names of all studies that a comparison can make, without loading ours."""
    return sorted({*plugin_names(STUDIES), *(name for name, method in methods().items() if method.study)})


@cache
def compare_options() -> Sequence[type[msgspec.Struct]]:
    """Return the `Options` of all methods, and of other packages' studies, in a comparison."""
    others = [
        one for one in load_plugins(STUDIES, "text", "placeholders").values() if hasattr(one, "Options")
    ]
    return [one.Options for one in (*methods().values(), *others)]


def find_method(name: str) -> type[Method]:
    """Return an installed method.

    Raises:
        BadInputError: it is not installed.
        NotAvailableError: it cannot be loaded.
    """
    method: type[Method] = load_plugin(METHODS, name, "make")
    return method
