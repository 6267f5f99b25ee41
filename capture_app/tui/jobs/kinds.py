"""The kinds of jobs: the command line of each, and settings that are quick and still tell."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.session.exporters.formats import FORMATS

CAPTURE, RECONSTRUCT = "capture_app.cli", "reconstruction.cli"
_PROGRAMS = {CAPTURE: "capture-app", RECONSTRUCT: "reconstruct"}


@dataclass(frozen=True, slots=True)
class JobKind:
    """One thing that can be done with a session in a process of its own."""

    name: str
    title: str
    what: str
    """What one gets of it, in a sentence."""
    module: str
    command: tuple[str, ...]
    quick: str = ""
    """Options that make it quick; a user may change them."""
    writes: bool = True
    """It writes a folder, which it is given by --out."""
    result: str = ""
    """The file of its folder that holds its figures; empty where there is nothing to look at."""
    report: str = ""
    """The file of its folder that a browser shows; empty where it writes none."""
    fixed: tuple[str, ...] = field(default=())

    def arguments(self, session: Path, out: Path | None, options: str) -> tuple[str, ...]:
        """The command line after the program's name. Raises BadInputError for options that are no words."""
        try:
            words = shlex.split(options)
        except ValueError as error:
            raise BadInputError(f"the options cannot be read: {error}", hint="close all quotes") from None
        for word in words:
            if word.partition("=")[0] in ("--out", "--json"):
                raise BadInputError(f"{word} is set by the job itself", hint="leave it out")
        target = () if out is None or not self.writes else ("--out", str(out))
        return (*self.command, str(session), *self.fixed, *words, *target, "--json")

    def command_line(self, session: Path, out: Path | None, options: str) -> str:
        """What one would type to do the same."""
        words = self.arguments(session, out, options)[:-1]
        return shlex.join((_PROGRAMS.get(self.module, self.module), *words))


COMPARE = JobKind(
    "compare",
    "Compare",
    "what synchronization is worth in this take",
    RECONSTRUCT,
    ("compare",),
    "--max-multiview-instants 3 --multiview-width 320",
    result="metrics.json",
    report="report.html",
)
MULTIVIEW = JobKind(
    "multiview",
    "Depth from all cameras",
    "depth maps and a point cloud of one instant",
    RECONSTRUCT,
    ("multiview",),
    "--instant 0 --no-mesh",
    result="multiview.json",
)
CLOUDS = JobKind(
    "clouds",
    "Clouds of all instants",
    "a cloud of each, and masks of what moves",
    RECONSTRUCT,
    ("multiview",),
    result="sequence.json",
    fixed=("--instants", "all"),
)
STITCH = JobKind(
    "stitch",
    "Panorama",
    "one wide picture, of one instant and late",
    RECONSTRUCT,
    ("stitch",),
    "--instant 0 --offset-ms 66",
    result="metrics.json",
)
DOSE = JobKind(
    "dose",
    "Tolerable delay",
    "how late a camera may be for good depth",
    RECONSTRUCT,
    ("dose",),
    "--max-instants 4",
    result="metrics.json",
    report="report.html",
)
PANEL = JobKind(
    "panel",
    "Panel",
    "how far apart the cameras were, by a panel",
    CAPTURE,
    ("panel", "read"),
    result="panel.json",
)
VERIFY = JobKind(
    "verify",
    "Verify",
    "whether every file is as it was saved",
    CAPTURE,
    ("sessions", "verify"),
    writes=False,
)
REPAIR = JobKind(
    "repair",
    "Repair",
    "finish it with the images that are there",
    CAPTURE,
    ("sessions", "repair"),
    "--wait-s 0",
    writes=False,
)
EXPORTS: Mapping[str, JobKind] = {
    name: JobKind(
        f"export-{name}",
        f"Export to {name}",
        what,
        CAPTURE,
        ("sessions", "export"),
        fixed=("--to", name),
    )
    for name, what in FORMATS.items()
}
STUDIES = (COMPARE, MULTIVIEW, STITCH, DOSE, CLOUDS, PANEL)
"""The jobs whose results can be looked at."""
KINDS: Mapping[str, JobKind] = {kind.name: kind for kind in (*STUDIES, VERIFY, REPAIR, *EXPORTS.values())}
