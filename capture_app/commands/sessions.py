"""`capture-app sessions`: list, show and verify; other modules have its other subcommands."""

from pathlib import Path
from typing import Any

import click

from capture_app.commands.session_changes import (
    empty,
    list_trash,
    note,
    rename,
    repair,
    restore,
    sheet,
    trash,
    wiggle,
)
from capture_app.commands.session_text import list_entry, list_lines, session_lines
from capture_app.commands.shared_options import ANY_PATH
from capture_app.common.errors import BadInputError, IncompleteError, SimulshotError
from capture_app.common.plugins import SESSION_COMMANDS, load_plugins
from capture_app.console.terminal import SESSION, answer, json_option, print_json, print_line, talk
from capture_app.console.usage import examples
from capture_app.session.files.output_folder import unfinished_outputs
from capture_app.session.format.manifest import session_schema_text
from capture_app.session.library.listing import list_sessions
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import judge

DEFAULT_ROOT = Path("sessions")


@click.group(epilog=examples("capture-app sessions list", "capture-app sessions show sessions/burst-001"))
def sessions() -> None:
    """List, show, verify, rename, annotate, trash, repair, import and export sessions."""


for command in (
    *load_plugins(SESSION_COMMANDS, "get_short_help_str").values(),
    *(repair, rename, note, trash, restore, empty, sheet, wiggle),
):
    sessions.add_command(command)


@sessions.command(
    "list",
    epilog=examples("capture-app sessions list", "capture-app sessions list ~/sessions --json"),
)
@click.argument("root", type=ANY_PATH, required=False)
@click.option("--trash", "trashed", is_flag=True, help="List the trash of ROOT instead.")
@json_option
def list_command(root: Path | None, trashed: bool, as_json: bool) -> None:
    """List the sessions in the folder ROOT (default: ./sessions)."""
    folder = root or DEFAULT_ROOT
    if trashed:
        list_trash(folder, as_json)
        return
    cards = [] if root is None and not folder.exists() else list_sessions(folder)
    answer(
        as_json,
        {"root": str(folder), "sessions": [list_entry(card) for card in cards]},
        list_lines(cards),
        said="" if cards else f"no sessions in {folder}",
    )
    for path in unfinished_outputs(folder):
        talk(f"{path} is incomplete: if no command is writing it, run capture-app sessions repair {folder}")


@sessions.command(epilog=examples("capture-app sessions show sessions/burst-001"))
@click.argument("session", type=SESSION)
@json_option
def show(session: Path, as_json: bool) -> None:
    """Show the cameras of a session and their synchronization."""
    opened = Session.open(session)
    verdict = judge(opened.manifest, arriving=opened.is_arriving)
    answer(
        as_json,
        {"session": str(session), "manifest": opened.manifest, "verdict": verdict},
        session_lines(opened),
    )


@sessions.command(epilog=examples("capture-app sessions verify sessions/burst-001 sessions/burst-002"))
@click.argument("paths", metavar="SESSION...", type=SESSION, nargs=-1, required=True)
@json_option
def verify(paths: tuple[Path, ...], as_json: bool) -> None:
    """Verify the integrity and internal consistency of sessions; fails if one has problems."""
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
        arriving = opened.is_arriving
        results.append({"session": str(path), "ok": not problems, "arriving": arriving, "problems": problems})
        if problems and failure is None:
            more = f" and {len(problems) - 1} more" if len(problems) > 1 else ""
            lost = all(problem.kind == "missing" for problem in problems)
            failure = (IncompleteError if lost else BadInputError)(
                f"{path} is damaged: {problems[0]}{more}",
                hint=f"copy it again, or try capture-app sessions repair {path}",
            )
        if not as_json:
            intact = f"all {len(opened.manifest.images)} images are intact"
            intact += "; further ones are still arriving" if arriving else ""
            for line in list(map(str, problems)) or [intact]:
                print_line(f"{path}: {line}")
    if as_json:
        print_json({"ok": failure is None, "sessions": results})
    if failure is not None:
        raise failure


@sessions.command(epilog=examples("capture-app sessions schema"))
def schema() -> None:
    """Print the JSON schema of session.json."""
    click.echo(session_schema_text(), nl=False)
