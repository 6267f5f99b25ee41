"""Words that people know from other programs, and the command or option of ours that each one means.

They are ffmpeg's, git's, docker's, OpenCV's, COLMAP's, nerfstudio's and camera apps'.
"""

import os
import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path

import click

OVERVIEW = (
    ". There are capture-app rig start, burst and record; capture-app sessions import FOLDER, list, show, "
    "note and export; reconstruct calibrate, time, multiview, people, view and splat SESSION"
)
"""What the answer to an unknown command shows."""
_COMMANDS = {
    "capture-app": {
        "capture-app burst": "capture shoot take snap photo picture snapshot shot trigger frames grab arm "
        "fire",
        "capture-app burst --name NAME, or record --name NAME": "new create create-session new-session",
        "capture-app burst --interval-s S": "timelapse time-lapse interval intervalometer shoot-interval "
        "capture-interval",
        "capture-app burst --on-motion": "motion motion-detection watch-trigger",
        "capture-app record": "video film movie rec recording grab-video capture-video",
        "capture-app record --stop": "end-recording stop-recording",
        "capture-app rig start": "start up run launch",
        "capture-app rig stop": "stop down quit kill shutdown end",
        "capture-app, without a command": "ui tui gui screen app open",
        "capture-app serve": "web browser",
        "capture-app leader": "server master host main controller serve-rig",
        "capture-app node --camera SPEC": "client slave join connect worker agent attach",
        "capture-app cameras": "devices list-devices list-cameras webcam webcams ls-cameras scan discover",
        "capture-app cameras add SPEC": "add-camera addcamera",
        "capture-app cameras set CONTROL=VALUE": "exposure gain focus settings config controls set shutter "
        "iso white-balance whitebalance wb",
        "capture-app cameras remove NAME": "kick eject",
        "capture-app node --camera SPEC,fps=N,width=W": "fps framerate resolution mode format",
        "capture-app trust pair LEADER": "pair login auth key keys",
        "capture-app sessions list": "ls list takes library history",
        "capture-app sessions trash SESSION": "delete rm remove del",
        "capture-app sessions export SESSION": "convert to save archive",
        "capture-app sessions note SESSION TEXT": "tag annotate comment",
        "capture-app sessions export SESSION --to otio": "edl xml fcpxml timeline premiere resolve davinci "
        "nle",
        "capture-app sessions export SESSION --to mcap": "rosbag ros2bag bag ros",
        "capture-app sessions export SESSION --to mp4": "mp4 mov prores encode transcode",
        "capture-app sessions restore SESSION": "undo undelete untrash",
        "capture-app sessions import SOURCE": "ingest gopro dji multicam clips sync synchronize align load "
        "add",
        "capture-app sessions sheet SESSION": "contact-sheet thumbnails",
        "capture-app demo": "simulate sim simulated simulation fake",
        "capture-app sessions show SESSION": "inspect describe probe info details metadata timestamps",
        "capture-app sessions verify SESSION": "check verify validate fsck",
        "capture-app sessions wiggle SESSION": "play",
        "capture-app sessions empty-trash": "purge clean empty-trash prune",
        "capture-app status": "sync-check sync-status test-sync sync-test nodes info stats state health "
        "sync synchronize genlock jam jam-sync accuracy clock latency dropped drops",
        "capture-app doctor": "check diagnose test disk space storage du firewall network wifi",
        "capture-app rig list": "ps rigs log logs",
        "capture-app, by the line that installed it (docs/install.md)": "update upgrade install",
        "capture-app, by make uninstall or pip uninstall simulshot": "uninstall",
        "capture-app phones": "phone mobile android ios qr join-qr pair-qr",
        "capture-app monitor": "dashboard live watch stream livestream broadcast",
        "capture-app --version": "version",
        "capture-app --help": "help",
        "capture-app people": "osc vmc live-people livemocap live-mocap",
        "reconstruct calibrate SESSION": "calibrate calibration calib intrinsics extrinsics lens lenses",
        "reconstruct, a command of its own": "reconstruct",
        "reconstruct multiview SESSION --out DIR": "photogrammetry depth depthmap depth-map mesh pointcloud "
        "3d multiview sfm mvs volumetric ply",
        "reconstruct stereo SESSION --out DIR": "stereo disparity",
        "reconstruct splat SESSION --out DIR": "splat splats gsplat gaussians gaussian-splat "
        "gaussian-splatting train 3dgs",
        "reconstruct trajectory SESSION --out DIR": "track trajectory tracking",
        "reconstruct panorama SESSION --out DIR": "panorama stitch pano",
        "reconstruct people SESSION --out DIR": "gait angles pose2d pose3d markerless pose poses skeleton "
        "mocap joints keypoints triangulate c3d bvh trc blender",
        "reconstruct movers SESSION --out DIR": "matte mattes mask masks movers",
        "reconstruct compare SESSION --out DIR": "compare evaluate report",
        "reconstruct time SESSION": "time offset offsets",
        "capture-app panel show": "timecode time-code led",
        "reconstruct board FILE": "make-board print-board board charuco chessboard checkerboard",
        "reconstruct view SESSION --out DIR": "orbit flythrough view walk render bullet-time bullettime "
        "freeze freeze-frame",
        "reconstruct view SESSION --page --out DIR": "share publish viewer",
    },
    "capture-app sessions": {
        "capture-app sessions trash SESSION": "delete rm remove del",
        "capture-app sessions list": "ls dir",
        "capture-app sessions show SESSION": "info inspect describe open details metadata size du",
        "capture-app sessions rename SESSION NAME": "mv move name",
        "capture-app sessions verify SESSION": "check validate fsck",
        "capture-app sessions repair SESSION": "fix recover resume",
        "capture-app sessions export SESSION": "convert save to",
        "capture-app sessions import SOURCE": "add load read from",
        "capture-app sessions note SESSION TEXT": "annotate comment tag",
        "capture-app sessions restore SESSION": "undelete undo untrash",
        "capture-app sessions sheet SESSION": "contact-sheet thumbnails preview",
        "capture-app sessions wiggle SESSION": "play view gif animate",
        "capture-app sessions empty-trash": "purge clean prune empty",
    },
    "reconstruct": {
        "reconstruct multiview SESSION --out DIR": "photogrammetry depth depthmap dense mvs pointcloud "
        "point-cloud cloud fusion 3d volumetric automatic_reconstructor patch_match_stereo stereo_fusion "
        "delaunay_mesher",
        "reconstruct multiview SESSION --mesh --out DIR": "mesh poisson mesher poisson_mesher",
        "reconstruct stereo SESSION --out DIR": "disparity sgbm pair",
        "reconstruct calibrate SESSION --mark CAMERA=X,Y --distance-m M": "scale align-gcp gcp",
        "reconstruct view SESSION --page --out DIR": "share",
        "reconstruct calibrate SESSION": "sfm sparse feature_extractor exhaustive_matcher "
        "sequential_matcher image_undistorter bundle_adjuster mapper calib calibration intrinsics "
        "extrinsics poses colmap",
        "reconstruct splat SESSION --out DIR": "splats gsplat gaussian gaussians gaussian-splat "
        "gaussian-splatting splatfacto train 3dgs nerf nerfacto",
        "reconstruct panorama SESSION --out DIR": "stitch pano stitching",
        "reconstruct view SESSION --out DIR": "orbit flythrough walk play render novel-view bullet-time "
        "bullettime wiggle viewer",
        "reconstruct time SESSION": "sync synchronize align offset offsets",
        "reconstruct people SESSION --out DIR": "gait angles pose2d pose3d markerless pose skeleton mocap "
        "joints keypoints motion-capture human body triangulate c3d bvh trc",
        "reconstruct movers SESSION --out DIR": "matte mattes mask masks segment rotoscope",
        "reconstruct trajectory SESSION --out DIR": "track ball path",
        "reconstruct compare SESSION --out DIR": "evaluate eval quality report",
        "reconstruct board FILE": "make-board print-board charuco chessboard checkerboard",
        "reconstruct batch SESSIONS": "all jobs slurm",
        "capture-app sessions import SOURCE": "import",
        "capture-app sessions export SESSION": "export convert",
        "capture-app sessions list": "list ls",
        "capture-app sessions show SESSION": "show info",
        "capture-app burst": "capture shoot burst",
        "capture-app record": "record video",
        "reconstruct --version": "version",
        "reconstruct --help": "help",
    },
    "capture-app cameras": {
        "capture-app cameras list": "ls devices scan discover find",
        "capture-app cameras show NAME": "info get inspect",
        "capture-app cameras remove NAME": "rm delete del disconnect",
        "capture-app cameras add SPEC": "open connect new attach",
        "capture-app cameras set CONTROL=VALUE": "config settings exposure gain focus control",
    },
    "capture-app rig": {
        "capture-app rig stop": "down kill quit end",
        "capture-app record": "record video film rec",
        "capture-app burst": "burst capture shoot take photo",
        "capture-app rig start": "up run launch new",
        "capture-app status": "status state",
        "capture-app rig list": "ls ps show",
        "capture-app cameras add SPEC, or capture-app node on another machine": "add connect",
        "capture-app cameras remove NAME": "remove",
    },
    "capture-app trust": {
        "capture-app trust list": "ls show",
        "capture-app trust pair LEADER": "join connect login",
        "capture-app trust remove MACHINE": "rm delete del revoke forget",
        "capture-app trust invite": "code qr new",
    },
}
"""Command lines by the group that was typed, with the words that mean them."""
FORMATS = {
    "otio": "premiere premiere-pro adobe resolve davinci davinci-resolve final-cut final-cut-pro fcp fcpx "
    "fcpxml xml edl aaf avid kdenlive hiero editor nle timeline",
    "splats": "blender gltf 3dgs gsplat gaussian-splatting gaussians inria postshot brush",
    "nerfstudio": "instant-ngp ngp nerf transforms",
    "colmap": "metashape agisoft realitycapture realityscan openmvs",
    "caliscope": "anipose",
    "pose2sim": "opensim mocap",
    "mcap": "foxglove ros rosbag ros2bag bag",
    "rrd": "rerun",
    "mp4": "video videos film movie h264 h265 hevc mov prores avi mkv webm after-effects aftereffects ae "
    "nuke fusion unreal unity",
}
"""Formats of `sessions export`, each with the programs that read it and other words for it."""
RESULTS = {
    "reconstruct people SESSION --out DIR": "c3d trc skeleton fbx bvh",
    "reconstruct multiview SESSION --out DIR": "ply las laz e57 obj pointcloud point-cloud mesh glb",
    "reconstruct movers SESSION --out DIR": "matte mattes mask masks",
}
"""Commands whose results people look for among the formats of an export, with words for them."""
_ACTIONS = {
    "capture-app theme": "dark light colour colours color colors night contrast appearance",
    "capture-app rig add": "webcam webcams usb device devices simulated simulate sim node connect",
    "capture-app rig board": "board charuco chessboard checkerboard print-board pdf paper",
    "capture-app cameras add": "rtsp ip-camera ip-cameras ipcam onvif network-camera cctv",
    "capture-app shoot live-people": "mocap joints skeleton",
    "capture-app app quit": "exit close leave",
    "capture-app app help": "keys shortcuts",
    "capture-app cameras set": "shutter iso lock-exposure",
    "capture-app node fps": "fps frame-rate framerate rate hz",
    "capture-app sessions empty-trash": "disk space storage size free",
    "capture-app sessions look": "disk storage size",
    "capture-app sessions sort": "two-takes compare-takes best rank order size largest disk storage du",
    "capture-app sessions import": "sound audio timecode",
    "capture-app rig remove": "kill stop-camera",
}
"""Actions of the screen that are not commands, written as if they were, with other words for them."""
_OPTIONS = {
    "--frames": "count n num number num-frames shots burst images vframes",
    "--count": "n num frames number max-frames vframes",
    "--out": "output o out-dir output-dir output-path dir dest destination outfile workspace-path to",
    "--to": "format f type output-format as",
    "--seconds": "duration t time length for hours minutes",
    "--interval-s": "interval timelapse",
    "--fps": "rate framerate frame-rate r hz",
    "--camera": "device source src input i cam spec cameras",
    "--leader": "server host address ip connect url",
    "--sessions": "dir folder out output data output-dir",
    "--name": "label title tag n",
    "--json": "output-json as-json machine",
    "--port": "p listen",
    "--host": "bind address ip listen",
    "--instant": "frame frames index at time",
    "--instants": "frames range",
    "--width": "size resolution scale res",
    "--cameras": "count n num devices",
    "--simulated": "fake sim dummy",
    "--replace": "overwrite force f y",
    "--yes": "y force",
    "--jobs": "j threads workers parallel num-workers",
    "--from": "method mode using",
    "--square-mm": "square square-size square-length size",
    "--marker-mm": "marker marker-size marker-length",
    "--watch": "follow f w",
    "--stop": "end finish",
    "--detach": "d background daemon",
    "--min-nodes": "min-cameras nodes cameras",
    "--quick": "fast preview draft quality",
    "--mesh": "poisson glb gltf obj",
    "--iterations": "steps iters max-iterations",
    "--verbose": "debug trace log-level",
    "--keypoints": "dlc deeplabcut openpose sleap mmpose alphapose coco",
    "--calibration": "intrinsics camera-params calib",
    "--every": "step stride skip",
    "--field-of-view": "fov hfov",
    "--to otio": "premiere resolve davinci edl fcpxml",
    "--to mp4": "codec mp4 video prores",
    "--align": "sync audio by",
    "--page": "paper",
}
"""Options, each with other programs' words for it, without hyphens; the first that a command has wins."""
_SIMULATED = {"--camera sim:phone-a": "simulated simulate sim simulation fake dummy virtual"}
_OPTIONS_OF = {
    "reconstruct calibrate": {
        "--board": "charuco chessboard checkerboard squares pattern",
        "--mark CAMERA=X,Y --distance-m M": "gcp scale",
    },
    "reconstruct multiview": {"--out DIR, with a PLY in it": "format ply las"},
    **dict.fromkeys(("capture-app", "capture-app node", "capture-app rig start"), _SIMULATED),
    "reconstruct people": {
        "--out DIR, with CSV, TRC, C3D and glTF in it": "c3d trc csv gltf glb fbx bvh format"
    },
    "capture-app sessions export": {
        **{f"--to {name}": f"{name} {words}" for name, words in FORMATS.items()},
        "in each export, as frames.csv": "csv",
        **{line: " ".join(f"format-{word}" for word in words.split()) for line, words in RESULTS.items()},
    },
}
"""Options that mean this of certain commands alone, in the same form."""
_MODELS = (".glb", ".gltf", ".obj", ".ply", ".usdz")
_OF_A_SESSION = {"reconstruct": "reconstruct compare", "capture-app": "capture-app sessions show"}
_FOOTAGE = (".mp4", ".mov", ".mkv", ".avi", ".mts", ".jpg", ".jpeg", ".png", ".tif", ".tiff")
_NUMBERS = {
    "integer": "a whole number",
    "integer range": "a whole number",
    "float": "a number",
    "float range": "a number",
}
"""What an option of a type takes, by click's name of the type."""
_TOO_MANY = re.compile(r"Got unexpected extra arguments? \((.*)\)")
_CLOSE = 0.75
"""Similarity from which a name counts as mistyped; click's own 0.6 takes `--json` for `--count`."""


def words_for(line: str) -> list[str]:
    """Return other programs' words for a command line, given without its arguments, or its binding."""
    return " ".join(
        [
            *(
                words
                for rows in (*_COMMANDS.values(), _ACTIONS)
                for meant, words in rows.items()
                if f"{meant} ".startswith(f"{line.replace('.', ' ')} ")
            ),
            FORMATS.get(line.rpartition(" --to ")[2], ""),
        ]
    ).split()


def takes_argument(line: str) -> bool:
    """Return whether a command line of ours ends in a placeholder, as `sessions show SESSION` does."""
    return line.split(" -")[0][-1:].isupper()


def advise(error: click.UsageError, typed_line: Sequence[str] = ()) -> str:
    """Return the message of a usage error, with what was probably meant by an unknown command or option."""
    models = [
        word
        for before, word in pairwise(("", *typed_line))
        if word.casefold().endswith(_MODELS) and "-" not in (before[:1], word[:1])
    ]
    if models and isinstance(error, click.MissingParameter | click.NoSuchCommand):
        return f"'{models[0]}' is a 3D model: Blender shows it, and reconstruct view shows sessions"
    if error.ctx is None or not isinstance(error, click.NoSuchOption | click.NoSuchCommand):
        return _in_our_words(error)
    command = error.ctx.command
    commands = _COMMANDS.get(error.ctx.command_path, {})
    names = command.list_commands(error.ctx) if isinstance(command, click.Group) else []
    if isinstance(error, click.NoSuchOption):
        what, typed, word = "option", error.option_name, error.option_name.lstrip("-").replace("_", "-")
        own = {f"{error.ctx.command_path} {word}": word} if word in names else {}
        names = [name for param in command.get_params(error.ctx) for name in param.opts if name[:1] == "-"]
        known = {line: words for line, words in _OPTIONS.items() if line.split()[0] in names}
        known = _OPTIONS_OF.get(error.ctx.command_path, {}) | known | commands | own
    else:
        what, typed, word = "command", error.command_name, error.command_name
        known = commands | {f"{error.ctx.command_path} {name} --help": f"help-{name}" for name in names}
        if place := _at_place(word, error.ctx.command_path):
            return place
    unknown = f"No such {what} '{typed}'"
    # Of two words, such as `grab video`, both together decide.
    after = typed_line[typed_line.index(typed) + 1 :] if typed in typed_line else ()
    meant = _lines_for(f"{word}-{after[0].lstrip('-')}", known) if after else []
    # A word of two meanings: `info take1` is about a session, `info` about the rig.
    meant += sorted(_lines_for(word, known), key=lambda line: takes_argument(line) is not bool(after))
    if meant:
        return f"{unknown}: it is {meant[0]}"
    close = get_close_matches(typed.casefold(), names, 1, _CLOSE)
    rows = _COMMANDS.get(error.ctx.command_path.split()[0], {}) if what == "option" else {}
    elsewhere = [
        f": it is {line}"
        for line in _lines_for(word, rows)
        if not f"{line} ".startswith(f"{error.ctx.command_path} ")
    ]
    if close:
        return f"{unknown}. Did you mean '{close[0]}'?"
    return unknown + ("".join(elsewhere[:1]) or (OVERVIEW if error.ctx.parent is None else ""))


def _at_place(word: str, program: str) -> str:
    """Return what to do with a file, a session or a folder in place of a command; empty for others."""
    if word.casefold().endswith(_FOOTAGE):
        return f"'{word}' is a file: capture-app sessions import FILE ... imports it"
    for place in (Path(word), Path("sessions", word)):
        is_session = os.path.isfile(place / "session.json")  # noqa: PTH113 - no word makes it raise
        if is_session and (line := _OF_A_SESSION.get(program)):
            return f"'{word}' is a session; the command comes first: {line} {place}"
    if "/" in word and not os.path.lexists(word):
        return f"there is nothing at {word}; the command comes first"
    if word.strip("./") and os.path.isdir(word):  # noqa: PTH112 - the same
        return f"'{word}' is a folder: capture-app sessions import {word} imports it"
    return ""


def _lines_for(word: str, rows: Mapping[str, str]) -> list[str]:
    return [line for line, words in rows.items() if word.casefold() in words.split()]


def _in_our_words(error: click.UsageError) -> str:
    """Return what an option or argument takes, and what it was given, instead of click's sentences."""
    text = error.message.rstrip(".")
    if isinstance(error, click.BadOptionUsage):
        return f"{error.option_name} needs a value" if "requires an argument" in text else text
    if not isinstance(error, click.BadParameter) or error.param is None:
        return _TOO_MANY.sub(
            lambda given: f"too many arguments: {given[1]}{_option_for(given[1], error)}", text
        )
    name, kind = error.param.get_error_hint(error.ctx).replace("'", ""), error.param.type
    if isinstance(error, click.MissingParameter):
        lists = {"--camera": "cameras lists what there is", "CAMERA": "status names those of the rig"}
        return f"{name} is missing" + (f"; capture-app {lists[name]}" if name in lists else "")
    given, is_not, _ = text.partition(" is not ")
    if not is_not or kind.name not in _NUMBERS:
        return f"{name}: {text}"
    low, high, is_open = (getattr(kind, part, None) for part in ("min", "max", "min_open"))
    limits = "".join(
        f" {word} {bound:.9g}"
        for word, bound in (("above" if is_open else "from", low), ("to", high))
        if bound is not None
    )
    return f"{name} takes {_NUMBERS[kind.name]}{limits}, not {given}"


def _option_for(given: str, error: click.UsageError) -> str:
    """Return the first option of the command that takes a number, for a number without one."""
    params = error.ctx.command.params if error.ctx and given.isdecimal() else []
    taking = [param.opts[0] for param in params if param.opts[0][:1] == "-" and param.type.name in _NUMBERS]
    return f" (write {taking[0]} {given})" if taking else ""
