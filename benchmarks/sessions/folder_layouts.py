"""Import drawn folders of every layout, and score what was stored by the identities in its pictures.

Each folder of `benchmarks.sessions.drawn_folders` (simulated) is imported by `capture-app sessions import
FOLDER` without an option. If the import asks, its question is answered as the folder's owner would, and the
result is scored too: python -m benchmarks.sessions.folder_layouts --folders 300 --seed 1

right        stored as it is, with no option
question     stored as it is after an option that the import named, or a doubt that nothing in it can remove
refused      nothing stored, and no option named that stores it
false pair   frames of different instants stored as one, with no doubt said
misled       as false pair, but only after a true answer to a question about another reading of the folder
lost pairs   as false pair, but with doubt, although the folder is clear
cameras      one camera as two, two as one, or a picture of none
takes        two takes as one, or a board's film as a take
incomplete   frames or takes are missing
names        right, but a camera's name is not as its owner wrote it
traceback    an error that is not a sentence
"""

import io
import os
import re
import shlex
import tempfile
import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.report import new_parser, print_report, print_table, talk
from benchmarks.sessions.drawn_folders import (
    BOARD_TAKE,
    KINDS,
    Folder,
    Shot,
    draw_folders,
    read_shot,
    write_folder,
)
from capture_app.cli import run
from capture_app.session.library.listing import list_sessions
from capture_app.session.reading.reader import Session

RIGHT = ("right", "question")
VERDICTS = (
    *RIGHT, "refused", "false pair", "misled", "lost pairs", "cameras", "takes",
    "incomplete", "names", "traceback",
)  # fmt: skip
MAX_ANSWERS = 2
"""Number of questions that an owner answers."""
LISTED = 16
"""Number of a failed folder's files, and of a command's lines, that are printed."""
MAX_READINGS = 6
"""Number of readings that an owner tries."""
SOURCE = "footage"
_OPTION = re.compile(r"--([a-z][a-z-]*)\b(?:[ =]('[^']*'|\"[^\"]*\"|[^\s,;:()`]+))?")
_NO_READINGS = frozenset(
    (
        "timestamps",
        "times",
        "fps",
        "synchronized",
        "align",
        "calibration",
        "unit",
        "fit",
        "name",
        "out",
        "apply",
    )
)
"""Options whose value an import cannot offer as a reading of the folder; `_answer` gives some of them."""


@dataclass(frozen=True)
class Outcome:
    """What an import said and stored of a folder, and the verdict about it."""

    folder: Folder
    verdict: str
    detail: str
    commands: tuple[str, ...]
    said: tuple[str, ...]
    """Exit code and output of each command."""


def main() -> None:
    """Import the drawn folders and print a row for each kind."""
    parser = new_parser(__doc__, seed_of="the folders")
    parser.add_argument("--folders", type=int, default=300, help="number of folders (300)")
    parser.add_argument("--only", metavar="WORDS", default="", help="kinds whose name has these words")
    parser.add_argument(
        "--show", metavar="KIND", help="print all folders of kinds with these words, the right too"
    )
    options = parser.parse_args()
    words = options.only or options.show or ""
    kinds = [name for name in KINDS if words in name]
    if not kinds:
        parser.error(f"no kind has {words!r} in its name; there are: {', '.join(KINDS)}")
    outcomes = []
    for number, folder in enumerate(draw_folders(options.seed, options.folders, kinds)):
        outcomes.append(import_folder(folder))
        if number % 50 == 49:
            talk(f"{number + 1} of {options.folders} folders")
    report = _summarize(outcomes, show_all=options.show is not None)
    print_report(report, _print, as_json=options.json)


def _summarize(outcomes: Sequence[Outcome], *, show_all: bool) -> dict[str, Any]:
    kinds: dict[str, Counter[str]] = {}
    for one in outcomes:
        kinds.setdefault(one.folder.kind, Counter())[one.verdict] += 1
    totals = Counter(one.verdict for one in outcomes)
    return {
        "folders": len(outcomes),
        "right": sum(totals[name] for name in RIGHT),
        "totals": dict(totals),
        "kinds": {kind: dict(of) for kind, of in kinds.items()},
        "shown": [_describe(one) for one in outcomes if show_all or one.verdict not in RIGHT],
    }


def _describe(one: Outcome) -> dict[str, Any]:
    folder = one.folder
    return {
        "kind": folder.kind,
        "verdict": one.verdict,
        "detail": one.detail,
        "unclear": folder.unclear,
        "script": folder.script,
        "source": folder.source,
        "files": folder.paths,
        "typed": list(one.commands),
        "said": list(one.said),
        "right": folder.right,
    }


def _print(report: dict[str, Any]) -> None:
    for one in report["shown"]:
        files = one["files"]
        print(f"\n== {one['kind']}: {one['verdict']}" + (f" ({one['detail']})" if one["detail"] else ""))
        half = LISTED // 2
        listed = files if len(files) <= LISTED else [*files[:half], f"... {len(files)} files", *files[-half:]]
        print("   " + "\n   ".join(listed))
        print("   typed: " + "\n   then:  ".join(one["typed"]))
        print("   said:")
        for said in one["said"]:
            lines = said.splitlines()
            more = [f"... {len(lines)} lines"] if len(lines) > LISTED else []
            print("      " + "\n      ".join([*lines[:LISTED], *more]))
        print(f"   right: {one['right']}" + (" (unclear to anybody)" if one["unclear"] else ""))
    print()
    used = [name for name in VERDICTS if name in report["totals"]]
    rows = [[kind, *(str(of.get(name, "")) for name in used)] for kind, of in report["kinds"].items()]
    print_table(["kind", *used], [*rows, ["all", *(str(report["totals"][name]) for name in used)]])
    print(f"\nright, or a question with the right option: {report['right']} of {report['folders']}")


def import_folder(folder: Folder) -> Outcome:
    """Import a folder as its owner would, answering what is asked, and judge what was stored."""
    with tempfile.TemporaryDirectory() as temporary:
        where = Path(temporary)
        write_folder(folder, where / SOURCE)
        trials = [_try(folder, [SOURCE], where / "out0")]
        while len(trials) <= MAX_ANSWERS and trials[-1].is_open and (answer := _answer(folder, trials[-1])):
            trials.append(_try(folder, [*trials[-1].arguments, *answer], where / f"out{len(trials)}"))
        last = trials[-1]
        if last.verdict not in RIGHT:
            # An owner knows his folder: of the readings that are offered to him, he takes the right one.
            for number, arguments in enumerate(_readings(trials[0].text)):
                reading = _try(folder, arguments, where / f"reading{number}")
                if reading.verdict in RIGHT:
                    trials, last = [trials[0], reading], reading
                    break
        verdict, detail = last.verdict, last.detail
        if len(trials) > 1:
            # Who answers for a folder that nobody can read has seen the reading that was asked about.
            misled = "question" if folder.unclear else "misled"
            verdict = {"right": "question", "false pair": misled}.get(verdict, verdict)
            detail = detail and f"after the answer: {detail}"
        commands = tuple(shlex.join(["sessions", "import", *one.arguments]) for one in trials)
        return Outcome(folder, verdict, detail, commands, tuple(f"[{one.code}] {one.text}" for one in trials))


@dataclass(frozen=True)
class _Trial:
    """One command: its arguments, what it printed, and the verdict about what it stored."""

    arguments: tuple[str, ...]
    code: int | None
    text: str
    verdict: str
    detail: str
    is_open: bool
    """Whether the result leaves a doubt or a fault that an answer may remove."""


def _try(folder: Folder, arguments: Sequence[str], out: Path) -> _Trial:
    code, text = _run(["sessions", "import", *arguments, "--out", str(out)], out.parent)
    text = text.replace(f"{out.parent}/", "")
    if code is None:
        return _Trial(tuple(arguments), code, text, "traceback", text.splitlines()[-1], is_open=False)
    sessions = [Session.open(one.folder) for one in list_sessions(out)] if out.is_dir() else []
    verdict, detail = judge(folder, sessions)
    sure = bool(sessions) and all(_is_sure(one) for one in sessions)
    is_open = verdict != "false pair" and not (verdict == "right" and sure)
    return _Trial(tuple(arguments), code, text, verdict, detail, is_open)


def _run(arguments: Sequence[str], where: Path) -> tuple[int | None, str]:
    """Return the exit code and what was printed; the code is None after an exception."""
    printed, before = io.StringIO(), Path.cwd()
    os.chdir(where)
    try:
        with redirect_stdout(printed), redirect_stderr(printed):
            code: int | None = run(list(arguments))
    except Exception as error:  # noqa: BLE001 - any exception of the program is a result here
        code = None
        printed.write(f"\n{type(error).__name__}: {error}")
    finally:
        os.chdir(before)
    lines = [line for line in printed.getvalue().splitlines() if line.strip() and not line.startswith("[")]
    text = "\n".join(lines)
    return (None if "Traceback (most recent" in text else code), text


def _answer(folder: Folder, trial: _Trial) -> list[str]:
    """Return an option that the import named and that is true of the folder, with its value."""
    asked = "\n".join(line for line in trial.text.splitlines() if not line.startswith("next:"))
    offered = [(match[1], _unquoted(match[2])) for match in _OPTION.finditer(asked)]
    for name in ("timestamps", "times", "synchronized", "fps"):
        values = [value for option, value in offered if option == name]
        if name not in folder.answers or not values or f"--{name}" in trial.arguments:
            continue
        if name == "timestamps":
            tables = [value for value in values if value.lower().endswith((".csv", ".txt"))]
            if tables:
                return [word for table in dict.fromkeys(tables) for word in ("--timestamps", table)]
        elif name != "times" or folder.answers[name] in values:
            return [f"--{name}"] + ([folder.answers[name]] if folder.answers[name] else [])
    return []


def _readings(text: str) -> list[list[str]]:
    """Return the arguments of each reading of the folder that the import offered: an option or a command."""
    readings = [[SOURCE, f"--{match[1]}", _unquoted(match[2])] for match in _OPTION.finditer(text)]
    readings = [one for one in readings if one[2] and one[1][2:] not in _NO_READINGS]
    for command in re.findall(r"capture-app sessions import ([^\n;)`]+)", text):
        with suppress(ValueError):  # a quote in a sentence around it
            readings.append(shlex.split(command.replace("RATE", "30").replace("FPS", "30")))
    return readings[:MAX_READINGS]


def _unquoted(value: str | None) -> str:
    return (value or "").strip("'\"").rstrip(".")


def _is_sure(session: Session) -> bool:
    times = session.stored_manifest.burst.common_times
    return times is None or times.state != "unknown"


def judge(folder: Folder, sessions: Sequence[Session]) -> tuple[str, str]:
    """Return the verdict about the sessions stored of a folder, and its reason.

    An owner's `unclear` folder is right whatever is stored, unless frames of different instants are one
    instant of a session that states no doubt.
    """
    faults = {name: reason for session in sessions for name, reason in _faults(folder, session)}
    if "false pair" in faults:
        return "false pair", faults["false pair"]
    if folder.unclear or (folder.is_one_camera and "cameras" not in faults):
        return "right", ""
    if not sessions:
        return "refused", ""
    if folder.unpaired:
        faults.pop("lost pairs", "")
    for name in ("cameras", "takes", "lost pairs"):
        if name in faults:
            return name, faults[name]
    if missing := _missing(folder, sessions):
        return "incomplete", missing
    return ("names", faults["names"]) if "names" in faults else ("right", "")


def _shown(session: Session) -> dict[tuple[str, int], Shot | None]:
    """Return what each stored image shows, by its camera and instant in the session."""
    shown = {}
    for record in session.manifest.images:
        image = cv2.imdecode(np.frombuffer(session.image_bytes(record), np.uint8), cv2.IMREAD_COLOR)
        shown[record.camera, record.instant] = None if image is None else read_shot(image.astype(np.uint8))
    return shown


def _faults(folder: Folder, session: Session) -> Iterable[tuple[str, str]]:
    shown = _shown(session)
    of_instant: dict[int, dict[str, Shot | None]] = {}
    of_camera: dict[str, set[Shot | None]] = {}
    for (camera, instant), shot in shown.items():
        of_instant.setdefault(instant, {})[camera] = shot
        of_camera.setdefault(camera, set()).add(shot)
    sure = _is_sure(session)
    for instant, images in of_instant.items():
        moments = {(shot.take, shot.instant) for shot in images.values() if shot}
        if len(moments) > 1:
            pairs = ", ".join(f"{camera} {_word(shot)}" for camera, shot in images.items())
            yield ("false pair" if sure else "lost pairs"), f"{session.name}, instant {instant}: {pairs}"
            break
    owners: dict[int, str] = {}
    for camera, shots in of_camera.items():
        cameras = {shot.camera if shot else None for shot in shots}
        if cameras == {None} or len(cameras) > 1:
            yield "cameras", f"{session.name}: {camera} shows {sorted(map(str, cameras))}"
        for one in cameras - {None}:
            if one in owners and one is not None:
                yield "cameras", f"{session.name}: {owners[one]} and {camera} are one camera"
            owners[one or 0] = camera
        takes = {shot.take for shot in shots if shot}
        if len(takes) > 1 or BOARD_TAKE in takes:
            yield "takes", f"{session.name}: {camera} holds the takes {sorted(takes)}"
    if not folder.is_one_camera and (wrong := _wrong_names(folder, session, owners)):
        yield "names", wrong


def _word(shot: Shot | None) -> str:
    return f"{shot.take}/{shot.instant}" if shot else "nothing"


def _wrong_names(folder: Folder, session: Session, owners: Mapping[int, str]) -> str:
    """Return which cameras have another name than their owner's, whatever all names have in common."""
    labels = {one.name: getattr(one, "label", None) or one.name for one in session.stored_manifest.cameras}
    known = {camera: name for camera, name in owners.items() if camera < len(folder.names)}
    given = _own_parts([labels[name] for name in known.values()])
    choices = zip(*(folder.names[camera] for camera in known), strict=True) if known else iter(())
    if not known or any(_own_parts(choice) == given for choice in choices):
        return ""
    pairs = (f"{folder.names[camera][0]} is {labels[name]}" for camera, name in known.items())
    return ", ".join(pairs)


def _own_parts(names: Sequence[str]) -> list[str]:
    """Return the names without case, separators, and the start and end that all of them share."""
    plain = [re.sub(r"[\s_.\-]+", "", unicodedata.normalize("NFC", name).casefold()) for name in names]
    if len(plain) == 1:
        return plain
    start = _common_length(plain)
    rest = [name[start:] for name in plain]
    end = _common_length([name[::-1] for name in rest])
    return [name[: len(name) - end] for name in rest]


def _common_length(names: Sequence[str]) -> int:
    """Return how many first letters all names share."""
    return len(list(takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))))


def _missing(folder: Folder, sessions: Sequence[Session]) -> str:
    """Return which take's frames of instants with two cameras or more are in no session."""
    stored = [{shot for shot in _shown(session).values() if shot} for session in sessions]
    for take in sorted({shot.take for shot in folder.shots} - {BOARD_TAKE}):
        shots = {shot for shot in folder.shots if shot.take == take}
        seen = Counter(shot.instant for shot in shots)
        wanted = {shot for shot in shots if seen[shot.instant] > 1}
        best = max((len(wanted & one) for one in stored), default=0)
        if best < len(wanted):
            return f"take {take}: {best} of {len(wanted)} frames in its fullest session"
    return ""


if __name__ == "__main__":
    main()
