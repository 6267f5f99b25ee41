"""Commands that the screen can run on a session, and one run of a command with its progress and outcome."""

import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from socket import gethostname
from typing import Annotated

from msgspec import Meta, Struct
from textual.content import Content

from capture_app.common.child import Child
from capture_app.common.errors import BadInputError
from capture_app.common.plugins import COMMANDS as PLUGIN_COMMANDS
from capture_app.common.plugins import SESSION_COMMANDS, plugin_names
from capture_app.common.text import ProgressStep, command_line, printable, rough_time
from capture_app.session.exporting.exporter import GROUP
from capture_app.session.format.manifest import CALIBRATION
from capture_app.tui.signs import Sign

CAPTURE, RECONSTRUCT = "capture_app.cli", "reconstruction.cli"
_PROGRAMS = {CAPTURE: "capture-app", RECONSTRUCT: "reconstruct"}
REPORT = "report.html"
"""Report in a run's folder, for commands that write one."""
METHODS = "simulshot.methods"
COVERAGE = "capture-app coverage"
"""Choice that is no run: the rig's own dialog does what this command does."""
OWN = f"{gethostname()}:{os.getpid()}"
"""Owner of the runs of this process."""
MEASURED_FRACTION = 1 / 3
"""Fraction of a run's steps after which the remaining time is estimated."""


@dataclass(frozen=True, slots=True)
class Command:
    """Command that processes a session in a separate process."""

    name: str
    title: str
    what: str
    """Result for the user, in one phrase."""
    module: str
    words: tuple[str, ...]
    quick: str = ""
    """Options for a quick run; the user may change them."""
    writes: bool = True
    """Whether the command writes a folder, given to it by --out."""
    result: str = ""
    """File with the figures in its folder; empty if there is none to display."""
    fixed: tuple[str, ...] = ()
    page: str = REPORT
    """Page in its folder, for people."""
    choices: tuple[tuple[str, str], ...] = ()
    """The choices that matter, each with its options; without any, only `quick` is offered."""
    replaces: str = ""
    """File of the session that it writes, and overwrites only with --replace."""

    def arguments(self, session: Path, out: Path | None, options: str) -> tuple[str, ...]:
        """Return the arguments after the program's name. Raises BadInputError for unreadable options."""
        try:
            words = shlex.split(options)
        except ValueError as error:
            raise BadInputError(f"the options are not valid: {error}", hint="close all quotes") from None
        for word in words:
            if word.partition("=")[0] in ("--out", "--json"):
                raise BadInputError(f"{word} is set by the job", hint="remove it")
        target = () if out is None or not self.writes else ("--out", str(out))
        return (*self.words, str(session), *self.fixed, *words, *target)

    def would_replace(self, session: Path, options: str) -> bool:
        """Whether it needs --replace, because the session has the file that it writes."""
        return (
            bool(self.replaces)
            and {"--replace", "--coverage", "session"}.isdisjoint(options.split())
            and (session / self.replaces).exists()
        )

    @property
    def program(self) -> str:
        """What is typed to run it, without arguments."""
        return f"{_PROGRAMS.get(self.module, self.module)} {' '.join(self.words)}"

    async def options_help(self, columns: int) -> str:
        """Return what its --help says of its options and their defaults. Raises SimulshotError."""
        arguments, variables = (self.module, *self.words, "--help"), {"COLUMNS": f"{columns + 2}"}
        child = await Child.start(self.title, arguments, variables=variables)
        try:
            return (await child.output()).decode(errors="replace").partition("\nOptions:\n")[2]
        finally:
            await child.stop()

    def line(self, session: Path, out: Path | None, options: str) -> str:
        """Return the equivalent command line."""
        return command_line(_PROGRAMS.get(self.module, self.module), *self.arguments(session, out, options))


_STUDIES = (
    Command(
        "compare",
        "Compare",
        "synchronized against offset images",
        RECONSTRUCT,
        ("compare",),
        "--max-multiview-instants 3 --multiview-width 320",
        result="metrics.json",
    ),
    Command(
        "multiview",
        "Depth from all cameras",
        "depth maps and a point cloud of one instant",
        RECONSTRUCT,
        ("multiview",),
        "--instant 0 --no-mesh",
        result="multiview.json",
    ),
    Command(
        "view",
        "Walk round",
        "a film, and a page to walk round in",
        RECONSTRUCT,
        ("view",),
        "--instant 0 --quick",
        result="view.json",
        fixed=("--page",),
        page="view.html",
        choices=(
            ("one instant, quick", "--instant 0 --quick"),
            ("one instant, full quality", "--instant 0"),
            ("all instants, as a film in 3D", "--instants all --quick"),
        ),
    ),
    Command(
        "splat",
        "Splat",
        "Gaussian splats, and a page of them",
        RECONSTRUCT,
        ("splat",),
        "--instant 0 --quick",
        result="splat.json",
        fixed=("--page",),
        page="splat.html",
        choices=(
            ("one instant, quick", "--instant 0 --quick"),
            ("one instant, full quality", "--instant 0"),
            ("all instants", "--instants all --quick"),
        ),
    ),
    Command(
        "people",
        "People",
        "their joints in 3D, with errors",
        RECONSTRUCT,
        ("people",),
        result="people.json",
        page="people.html",
    ),
    Command(
        "calibrate",
        "Calibrate",
        "lenses and places of the cameras",
        RECONSTRUCT,
        ("calibrate",),
        "--from sfm",
        writes=False,
        choices=(
            ("from the scene", "--from sfm"),
            ("live: which views of a board are missing", COVERAGE),
            ("from a board in the pictures", "--from board --board 7x5 --square-mm 35"),
        ),
        replaces=CALIBRATION,
    ),
    Command(
        "time",
        "Time offsets",
        "by what moves, or by a lamp",
        RECONSTRUCT,
        ("time",),
        writes=False,
        choices=(
            ("measure", ""),
            ("measure, and set a recording's times", "--apply"),
            ("pair again where frames were dropped", "--repair-drops"),
        ),
    ),
    Command(
        "panorama",
        "Panorama",
        "one wide picture, synchronized and offset",
        RECONSTRUCT,
        ("panorama",),
        "--instant 0 --condition 66",
        result="metrics.json",
    ),
    Command(
        "tolerance",
        "Tolerable delay",
        "maximum camera delay for good depth",
        RECONSTRUCT,
        ("tolerance",),
        "--max-instants 4",
        result="metrics.json",
    ),
    Command(
        "clouds",
        "Clouds of all instants",
        "point clouds and motion masks",
        RECONSTRUCT,
        ("multiview",),
        result="sequence.json",
        fixed=("--instants", "all"),
    ),
    Command(
        "panel",
        "Panel",
        "time differences seen on a panel",
        CAPTURE,
        ("panel", "read"),
        result="panel.json",
    ),
)
_OF_PLUGINS = dict.fromkeys(("multiview", "view", "splat", "people", "panorama"), METHODS) | {
    "panel": PLUGIN_COMMANDS
}
"""Groups of the plugins that these commands are."""
STUDIES = tuple(
    one
    for one in _STUDIES
    if (group := _OF_PLUGINS.get(one.words[0])) is None or one.words[0] in plugin_names(group)
)
"""Commands offered for their results, if what they run is installed."""
MOMENT = Command(
    "moment",
    "Depth of one instant",
    "quick depth of one instant, and a 3D page",
    RECONSTRUCT,
    ("multiview",),
    "--instant 0",
    result="multiview.json",
    fixed=("--quick", "--page", "--calibrated"),
)
VERIFY = Command(
    "verify",
    "Verify",
    "check that every file is intact",
    CAPTURE,
    ("sessions", "verify"),
    writes=False,
)
REPAIR = Command(
    "repair",
    "Repair",
    "complete it with the images received",
    CAPTURE,
    ("sessions", "repair"),
    "--wait-s 0",
    writes=False,
)
IMPORT = Command(
    "import",
    "Import",
    "a folder of videos or another program's recording",
    CAPTURE,
    ("sessions", "import"),
)
EXPORTS: Mapping[str, Command] = {
    name: Command(
        f"export-{name}",
        f"Export to {name}",
        "",
        CAPTURE,
        ("sessions", "export"),
        fixed=("--to", name),
    )
    for name in plugin_names(GROUP)
}
CAN_IMPORT, CAN_EXPORT = (name in plugin_names(SESSION_COMMANDS) for name in ("import", "export"))
"""Whether these commands, which are plugins, are installed."""
COMMANDS = {one.name: one for one in (*STUDIES, MOMENT, VERIFY, REPAIR, IMPORT, *EXPORTS.values())}


class RunState(StrEnum):
    """State of a run."""

    WAITING = "waiting"
    RUNNING = "running"
    PAUSED = "paused"
    """Suspended while a burst is taken or saved, which needs the whole machine."""
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"
    NOT_APPLICABLE = "not applicable"
    """The session lacks what the automatic depth needs, such as a calibration."""

    @property
    def is_over(self) -> bool:
        """Whether the run has ended."""
        return self not in (RunState.WAITING, RunState.RUNNING, RunState.PAUSED)


class Run(Struct, eq=False, kw_only=True, omit_defaults=True):
    """Run of a command, as stored in its file."""

    kind: str
    """Name of its command."""
    session: Path
    out: Path | None = None
    options: str = ""
    state: RunState = RunState.WAITING
    message: str = ""
    """Outcome in a sentence: the verdict, what was written, or the error."""
    ended: Annotated[datetime, Meta(tz=True)] | None = None
    seconds: float = 0.0
    """Run time in seconds, without the time paused."""
    processor_s: float = 0.0
    """CPU time in seconds, over all processors."""
    step: ProgressStep | None = None
    owner: str = ""
    """Machine and process of the screen that runs it: HOST:PID."""

    @property
    def is_foreign(self) -> bool:
        """Whether it runs in another screen of this machine."""
        return not self.state.is_over and self.owner not in ("", OWN)

    @property
    def command(self) -> Command:
        """Command of this run."""
        return COMMANDS[self.kind]

    @property
    def key(self) -> str:
        """Unique key: there is one run per command and session."""
        return f"{self.kind} {self.session.absolute()}"

    @property
    def line(self) -> str:
        """Equivalent command line."""
        return self.command.line(self.session, self.out, self.options)

    @property
    def result(self) -> Path | None:
        """File with the figures, from this or an earlier run to the same folder, if any."""
        if not self.state.is_over or self.out is None or not self.command.result:
            return None
        path = self.out / self.command.result
        return path if path.is_file() else None

    @property
    def report(self) -> Path | None:
        """Report in its folder, if any; while it runs, as far as it is written."""
        if self.out is None or (self.state.is_over and self.result is None):
            return None
        report = self.out / self.command.page
        return report if report.is_file() else None

    @property
    def fraction(self) -> float | None:
        """Completed fraction by steps, 0 to 1; None if unknown or if the run has ended."""
        if self.state.is_over or self.step is None or self.step.total <= 0:
            return None
        # A progress line announces the step that begins.
        return min(1.0, max(0.0, (self.step.done - 1) / self.step.total))

    @property
    def seconds_left(self) -> float | None:
        """Estimated remaining time in seconds, for equal steps; None before a third of them is done."""
        # The first steps are the shortest: extrapolating them turns a quarter of an hour into seconds.
        fraction = self.fraction or 0.0
        return self.seconds * (1 - fraction) / fraction if fraction >= MEASURED_FRACTION else None

    def __str__(self) -> str:
        """Return title, session and progress: Compare of burst-001 (11 %)."""
        far = str(self.state) if self.fraction is None else f"{100 * self.fraction:.0f} %"
        return f"{self.command.title} of {self.session.name} ({far})"


SIGNS = {
    RunState.WAITING: Sign("○", "waiting", "$foreground-muted"),
    RunState.RUNNING: Sign("▶", "running", "$primary"),
    RunState.PAUSED: Sign("⏸", "paused", "$warning"),
    RunState.DONE: Sign("✔", "done", "$success"),
    RunState.FAILED: Sign("✖", "failed", "$error"),
    RunState.NOT_APPLICABLE: Sign("–", "not applicable", "$foreground-muted"),
    RunState.CANCELLED: Sign("◌", "cancelled", "$foreground-muted"),
}


def progress_words(run: Run) -> str:
    """Return a run's progress in words: 43 % · 2 min left · stereo cam00-cam01."""
    parts = [] if run.fraction is None else [f"{100 * run.fraction:.0f} %"]
    if run.seconds_left is not None:
        parts.append(f"about {rough_time(run.seconds_left)} left")
    if run.step is not None:
        parts.append(printable(run.step.text))
    return " · ".join(parts)


def run_tag(run: Run) -> Content:
    """Return a run's short label for the list of sessions: glyph, command and progress."""
    sign = SIGNS[run.state]
    fraction = "" if run.fraction is None else f" {100 * run.fraction:.0f} %"
    return Content.styled(f"{sign.glyph} {run.command.title.lower()}{fraction}", sign.style)
