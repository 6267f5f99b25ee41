"""`capture-app sessions import`: other programs' recordings become sessions."""

import subprocess
import sys
from itertools import chain
from pathlib import Path
from typing import Any

import click

from capture_app.commands.session_text import session_lines
from capture_app.commands.shared_options import ANY_PATH, restrict_file_access
from capture_app.common.errors import BadInputError
from capture_app.common.names import label_of
from capture_app.common.optional_packages import RECONSTRUCTION
from capture_app.common.plugins import plugin_names
from capture_app.common.text import count
from capture_app.companions.importing.next_steps import are_times_uncertain, describe_steps
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import TIME_SHIFT, FiniteRange, answer, json_option, show_count, talk
from capture_app.console.usage import examples, write_plugins
from capture_app.session.alignment.alignment_method import GROUP as ALIGNMENTS
from capture_app.session.reading.reader import Session

_MOTION_S, _MAX_MOTION_S = 0.25, 30.0
"""Processor time of an alignment by motion, s an image (110 s for 4 x 100 of 1080 x 1920); its budget, s."""


class _ImportCommand(RuledCommand):
    """A command whose help lists the importers."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write what is recognized, then the examples."""
        from capture_app.session.importing.importer import load_importers

        write_plugins(
            formatter, "Recognized", [(importer.program, importer.help) for importer in load_importers()]
        )
        super().format_epilog(ctx, formatter)


@click.command(
    "import",
    cls=_ImportCommand,
    rules=(Rule("--sound-distance-m --sound-delay-ms", "--align=auto|sound"),),
    epilog=examples(
        "capture-app sessions import footage",
        "capture-app sessions import left=left.mp4 right=right.mp4 --name walk",
        "capture-app sessions import recording --fps 30 --calibration calibration.toml",
    ),
)
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True)
@click.option(
    "--fps",
    type=float,
    metavar="FPS",
    help="Frame rate. Images with equal frame numbers are the same instant; videos only with --synchronized.",
)
@click.option(
    "--synchronized",
    is_flag=True,
    help="The recorder synchronized its cameras: equal frame numbers of the videos are the same instant.",
)
@click.option(
    "--timestamps",
    metavar="[NAME=]CSV",
    multiple=True,
    help="Table of frame times with the columns camera, time, and frame or sync_index; or one a camera.",
)
@click.option(
    "--times",
    type=click.Choice(["auto", "video", "name", "exif"]),
    default="auto",
    help="Source of the frame times: timestamps in the videos, file names of the images, or EXIF.",
)
@click.option(
    "--time-shift-ms",
    "shifts",
    type=TIME_SHIFT,
    metavar="CAMERA=MS",
    multiple=True,
    help="Add MS to the times of a camera, as for phones started by hand. Repeatable.",
)
@click.option(
    "--align",
    type=click.Choice(["auto", "none", "motion", *plugin_names(ALIGNMENTS)]),
    default="auto",
    help="Method that aligns videos without common times. auto tries all, and motion for short takes.",
)
@click.option(
    "--sound-distance-m",
    type=FiniteRange(min=0),
    metavar="M",
    default=1.0,
    help="Max difference of the cameras' distances to the sound. Part of the error bar.",
)
@click.option(
    "--sound-delay-ms",
    type=FiniteRange(min=0),
    metavar="MS",
    default=20.0,
    help="Max difference of the cameras' audio delays. Part of the error bar; 0 for equal models.",
)
@click.option("--start", type=click.IntRange(min=0), metavar="N", default=0, help="First instant to import.")
@click.option(
    "--count",
    type=click.IntRange(min=1),
    metavar="N",
    show_default="all",
    help="Number of instants to import.",
)
@click.option("--every", type=click.IntRange(min=1), metavar="N", default=1, help="Import every Nth instant.")
@click.option(
    "--calibration",
    metavar="[NAME=]PATH",
    multiple=True,
    help="Calibration of all cameras or of NAME: a file or folder as listed below.",
)
@click.option(
    "--unit",
    show_default="m; arbitrary for formats without a scale",
    help="Unit of lengths in the calibration: m, cm, mm, in, ft or another name.",
)
@click.option(
    "--fit",
    type=click.Choice(["exact", "crop", "scale"]),
    default="exact",
    help="How images relate to the calibrated size: the same, cropped at right and bottom, or scaled.",
)
@click.option(
    "--uncertainty-ms", type=FiniteRange(min=0), metavar="MS", help="Uncertainty (95 %) of the times."
)
@click.option(
    "--recording",
    metavar="NAME",
    help="Name of the recording to import, if the folder has several.",
)
@click.option(
    "--split",
    type=click.Choice(["side-by-side"]),
    help="Each picture holds a left and a right view, as of stereo cameras: they become two cameras.",
)
@click.option("--png", is_flag=True, help="Save video frames as PNG instead of JPEG.")
@click.option("--name", show_default="the recording's folder name", help="Name of the session.")
@click.option("--out", type=ANY_PATH, metavar="DIR", default=Path("sessions"), help="Folder for the session.")
@json_option
def import_command(
    sources: tuple[str, ...],
    name: str | None,
    out: Path,
    shifts: tuple[tuple[str, float], ...],
    timestamps: tuple[str, ...],
    as_json: bool,
    **options: Any,
) -> None:
    """Import a recording as a session. SOURCE is NAME=PATH of each camera, or a folder of cameras.

    A camera is a video file, a folder of images, or a recording of a program below. Images are copied
    unchanged. Each group of videos taken together becomes a session, with a calibration found beside it.
    Recordings of the programs below are recognized, with their times and calibration. An export of `sessions
    export` becomes the original session. The verdict and the next command are printed at the end.
    """
    from capture_app.companions.importing.import_options import ImportOptions
    from capture_app.companions.importing.recording import import_found
    from capture_app.session.importing.importer import split_name

    restrict_file_access()
    if name is None:
        path = split_name(sources[0])[1].resolve()
        own = path if len(sources) == 1 and path.is_dir() else path.parent
        name = label_of(own.name) or "recording"
    tables = [split_name(table) for table in timestamps]
    chosen = ImportOptions(offsets_ms=dict(shifts), timestamps=tables, **options)
    written = import_found(sources, out, name, chosen, show_count("images"), talk)
    made = [_aligned_by_motion(session, chosen.align) for session in written]
    result = [
        {
            "session": str(session.folder),
            "cameras": [camera.name for camera in session.manifest.cameras],
            "instants": len(session.manifest.burst.instants_ns),
            "images": len(session.manifest.images),
            "missing": len(session.manifest.missing),
            "calibrated": session.calibration() is not None,
        }
        for session in made
    ]
    answer(
        as_json,
        result[0] if len(result) == 1 else {"sessions": result},
        chain.from_iterable(map(session_lines, made)),
    )
    for session in made:
        _say_next(session)


def _aligned_by_motion(session: Session, align: str) -> Session:
    """Align a calibrated session by motion if its times are uncertain; return the session as it is then.

    By default only within a budget of time; `align` may ask for it, or for another method only.
    """
    from importlib.util import find_spec

    uncertain = are_times_uncertain(session) and session.calibration() is not None
    if not uncertain or find_spec(RECONSTRUCTION) is None or align not in ("auto", "motion"):
        return session
    images = len(session.manifest.images)
    if align == "auto" and (cost_s := images * _MOTION_S) > _MAX_MOTION_S:
        talk(f"motion was not tried: {count(images, 'image')}, some {cost_s:.0f} s; --align motion does")
        return session
    talk("aligning by motion, as no other method applies")
    command = [sys.executable, "-m", "reconstruction.cli", "time", str(session.folder), "--apply"]
    result = subprocess.run(command, check=False, capture_output=True, text=True)  # noqa: S603 - our own program
    lines = (result.stdout if result.returncode == 0 else result.stderr).strip().splitlines()
    talk(f"by motion: {lines[-1] if lines else 'no answer'}")
    return Session.open(session.folder)


def _say_next(session: Session) -> None:
    """Verify a written session and print the next commands. Raises BadInputError if it is damaged."""
    from capture_app.session.reading.verify import verify

    problems = verify(session)
    if problems:
        raise BadInputError(f"{session.folder} is damaged: {problems[0]}", hint="import it again")
    talk(f"all {count(len(session.manifest.images), 'image')} verified")
    for line in describe_steps(session):
        talk(line)
