"""`capture-app sessions`: list, show, verify, import and render; the other files hold the rest."""

from pathlib import Path
from typing import Any

import click
import msgspec

from capture_app.commands.options import ANY_PATH
from capture_app.commands.sessions.export import export
from capture_app.commands.sessions.organize import empty, list_trash, note, rename, restore, trash
from capture_app.commands.sessions.repair import repair
from capture_app.commands.sessions.sheet import sheet, wiggle
from capture_app.commands.sessions.text import print_session, print_sessions
from capture_app.errors import BadInputError, IncompleteError, SimulshotError
from capture_app.session.files.output_folder import unfinished_outputs
from capture_app.session.format.manifest import session_schema_text
from capture_app.session.reading.reader import Session, list_sessions
from capture_app.session.reading.verdict import judge
from capture_app.terminal import FiniteRange, json_option, print_json, print_line, show_count, talk
from capture_app.usage import examples

DEFAULT_ROOT = Path("sessions")


@click.group(epilog=examples("capture-app sessions list", "capture-app sessions show sessions/burst-001"))
def sessions() -> None:
    """List, show, verify, rename, annotate, trash, repair, import and export sessions."""


for command in (export, repair, rename, note, trash, restore, empty, sheet, wiggle):
    sessions.add_command(command)


@sessions.command(
    "list",
    epilog=examples("capture-app sessions list", "capture-app sessions list ~/sessions --json"),
)
@click.argument("root", type=ANY_PATH, required=False)
@click.option("--trash", "trashed", is_flag=True, help="List those in the trash of ROOT instead.")
@json_option
def list_command(root: Path | None, trashed: bool, as_json: bool) -> None:
    """List the sessions in the folder ROOT (default: ./sessions)."""
    nothing_yet = root is None and not DEFAULT_ROOT.exists()
    root = root or DEFAULT_ROOT
    if trashed:
        list_trash(root, as_json)
        return
    found = [] if nothing_yet else list_sessions(root)
    if as_json:
        print_json({"root": str(root), "sessions": found})
    elif found:
        print_sessions(found)
    else:
        talk(f"no sessions in {root}")
    for path in unfinished_outputs(root):
        talk(f"{path} is being written, or what a killed run left of it: capture-app sessions repair {root}")


@sessions.command(epilog=examples("capture-app sessions show sessions/burst-001"))
@click.argument("session", type=ANY_PATH)
@json_option
def show(session: Path, as_json: bool) -> None:
    """Show the cameras of a session and how well they were synchronized."""
    opened = Session.open(session)
    if as_json:
        verdict = judge(opened.manifest)
        print_json({"session": str(session), "manifest": opened.manifest, "verdict": verdict})
    else:
        print_session(opened)


@sessions.command(epilog=examples("capture-app sessions verify sessions/burst-001 sessions/burst-002"))
@click.argument("paths", metavar="SESSION...", type=ANY_PATH, nargs=-1, required=True)
@json_option
def verify(paths: tuple[Path, ...], as_json: bool) -> None:
    """Verify the integrity and internal consistency of sessions; fails if one has problems."""
    from capture_app.session.reading.verify import ProblemKind
    from capture_app.session.reading.verify import verify as verify_session

    results: list[dict[str, Any]] = []
    failure: SimulshotError | None = None
    for path in paths:
        try:
            opened = Session.open(path)
            problems = verify_session(opened)
        except SimulshotError as error:
            results.append({"session": str(path), "ok": False, "error": str(error), "problems": []})
            failure = failure or error
            continue
        results.append({"session": str(path), "ok": not problems, "problems": problems})
        if problems and failure is None:
            more = f" and {len(problems) - 1} more" if len(problems) > 1 else ""
            what = f"{path} is damaged: {problems[0]}{more}"
            lost = all(problem.kind is ProblemKind.MISSING for problem in problems)
            failure = IncompleteError(what) if lost else BadInputError(what)
        if not as_json:
            for problem in problems:
                print_line(f"{path}: {problem}")
            if not problems:
                print_line(f"{path}: all {len(opened.manifest.images)} images are intact")
    if as_json:
        print_json({"ok": failure is None, "sessions": results})
    if failure is not None:
        raise failure


@sessions.command(epilog=examples("capture-app sessions schema"))
def schema() -> None:
    """Print the JSON schema of session.json."""
    click.echo(session_schema_text(), nl=False)


@sessions.command(epilog=examples("capture-app sessions render sample_sessions/jumper --out renders"))
@click.argument("recipes", metavar="RECIPE...", type=ANY_PATH, nargs=-1, required=True)
@click.option("--out", type=ANY_PATH, default=DEFAULT_ROOT, metavar="DIR", help="Folder for the sessions.")
@click.option("--name", show_default="that in the recipe", help="Name of the session.")
@click.option(
    "--retake",
    is_flag=True,
    help="Simulate the burst again instead of using the times recorded in the recipe.",
)
@click.option("--replace", is_flag=True, help="Replace an earlier rendering.")
@json_option
def render(
    recipes: tuple[Path, ...], out: Path, name: str | None, retake: bool, replace: bool, as_json: bool
) -> None:
    """Render simulated sessions. RECIPE is a recipe.json or a session that was rendered from one.

    Where the recipe has no frame times yet, a simulated rig takes the burst, and the recipe.json in the
    session records them. The same recipe always gives the same bytes.
    """
    from capture_app.samples.recipe import read_recipe
    from capture_app.samples.render import render as render_recipe

    if name is not None and len(recipes) > 1:
        raise BadInputError("--name is for one recipe", hint="render the recipes one by one")
    results = []
    for path in recipes:
        recipe = read_recipe(path)
        if name is not None:
            recipe = msgspec.structs.replace(recipe, name=name)
        if retake:
            recipe = msgspec.structs.replace(recipe, take=None)
        rendered = render_recipe(recipe, out, replace=replace, progress=show_count("images"))
        folder = str(rendered.session.folder)
        results.append({"session": folder, "same_bytes_as_before": rendered.same})
        if not as_json:
            if rendered.same is not None:
                print_line(f"{folder}: {'unchanged' if rendered.same else 'changed'}")
            else:
                print_session(rendered.session)
    if as_json:
        print_json({"sessions": results})


@sessions.command(
    "import",
    epilog=examples(
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
    type=ANY_PATH,
    metavar="CSV",
    help="Table of frame times with the columns camera, time, and frame or sync_index.",
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
    metavar="CAMERA=MS",
    multiple=True,
    help="Add this to the times of a camera, as for phones started by hand. Repeat for several.",
)
@click.option("--start", type=int, metavar="N", default=0, help="First instant to import.")
@click.option("--count", type=int, metavar="N", show_default="all", help="Number of instants to import.")
@click.option("--every", type=int, metavar="N", default=1, help="Import every Nth instant.")
@click.option(
    "--calibration",
    metavar="[NAME=]PATH",
    multiple=True,
    help="Calibration: calibration.json of a session; OpenCV .npz/.yml/.xml of a camera or a pair or a "
    "folder of these; Caliscope or Anipose .toml; Qualisys .qca.txt; EasyMocap, COLMAP or OpenCap folder; "
    "rig_config.json; transforms.json.",
)
@click.option(
    "--unit",
    show_default="m; arbitrary for COLMAP and nerfstudio",
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
    help="Which of several recordings in the folder: Caliscope's by name, OpenCap's trial, RecSync's time.",
)
@click.option("--png", is_flag=True, help="Save video frames as PNG instead of JPEG.")
@click.option("--name", show_default="that of the recording's folder", help="Name of the session.")
@click.option("--note", default="", show_default=False, help="A line of text saved with the session.")
@click.option("--out", type=ANY_PATH, metavar="DIR", default=DEFAULT_ROOT, help="Folder for the session.")
@json_option
def import_command(
    sources: tuple[str, ...],
    name: str | None,
    out: Path,
    fit: str,
    times: str,
    shifts: tuple[str, ...],
    as_json: bool,
    **options: Any,
) -> None:
    """Import a recording as a session. SOURCE is NAME=PATH of each camera, or a folder of cameras.

    A camera is a folder of images, which are copied unchanged, a video file, or a folder written by
    libsoftwaresync, RecSync or RecSyncNG on a phone. Folders of Caliscope, FreeMoCap and OpenCap are
    recognized, with their times and calibration. So are .mcap files, and what `sessions export` made for
    COLMAP, nerfstudio, Pose2Sim and others, which becomes the session again that it was made of.
    """
    from capture_app.session.importers.calibrations.reading import Fit
    from capture_app.session.importers.embedded_times import TimeSource
    from capture_app.session.importers.open_sources import split_name
    from capture_app.session.importers.recording import ImportOptions, import_recording

    if name is None:
        path = split_name(sources[0])[1].resolve()
        name = path.name if len(sources) == 1 and path.is_dir() else path.parent.name
    chosen = ImportOptions(
        fit=Fit(fit), times=TimeSource(times), offsets_ms=_parse_time_shifts(shifts), **options
    )
    session = import_recording(sources, out, name, chosen, show_count("images"), talk)
    manifest = session.manifest
    if not as_json:
        print_session(session)
        return
    print_json(
        {
            "session": str(session.folder),
            "cameras": [camera.name for camera in manifest.cameras],
            "instants": len(manifest.burst.instants_ns),
            "images": len(manifest.images),
            "missing": len(manifest.missing),
            "calibrated": session.calibration() is not None,
        }
    )


def _parse_time_shifts(texts: tuple[str, ...]) -> dict[str, float]:
    found = {}
    for text in texts:
        camera, _, value = text.rpartition("=")
        try:
            found[camera] = float(value)
            round(found[camera])  # neither infinite nor NaN
        except (ValueError, OverflowError):
            raise BadInputError(
                f"--time-shift-ms {text} is not CAMERA=MS", hint="example: cam1=-12.5"
            ) from None
    return found
