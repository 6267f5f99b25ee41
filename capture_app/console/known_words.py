"""Words that people know from other programs, and the command or option of ours that each one means.

They are ffmpeg's, git's, docker's, OpenCV's, COLMAP's, nerfstudio's and those of camera apps.
"""

import re
from difflib import get_close_matches

import click

_COMMANDS = {
    "capture-app": {
        "capture-app burst": "capture shoot take snap photo picture snapshot shot trigger frames grab",
        "capture-app record": "video film movie stream rec recording",
        "capture-app record --stop": "end-recording stop-recording",
        "capture-app rig start": "start up run launch",
        "capture-app rig stop": "stop down quit kill shutdown end",
        "capture-app rig list": "ps rigs",
        "capture-app": "ui tui gui screen app open play",
        "capture-app serve": "web browser",
        "capture-app leader": "server master host main controller serve-rig",
        "capture-app node --camera SPEC": "client slave join connect worker agent attach",
        "capture-app cameras": "devices list-devices list-cameras webcam webcams ls-cameras scan discover",
        "capture-app cameras set CONTROL=VALUE": "exposure gain focus settings config controls set",
        "capture-app trust pair LEADER": "pair login auth key keys",
        "capture-app sessions list": "ls list takes library history",
        "capture-app sessions trash SESSION": "delete rm remove del",
        "capture-app sessions export SESSION": "convert to",
        "capture-app demo": "simulate sim simulated simulation fake",
        "capture-app sessions show SESSION": "inspect describe probe",
        "capture-app status": "info stats state health sync synchronize",
        "capture-app doctor": "check diagnose test",
        "capture-app, installed again as at first": "update upgrade install",
        "capture-app phones": "phone mobile android ios qr",
        "capture-app monitor": "dashboard live watch",
        "capture-app --version": "version",
        "capture-app --help": "help",
        "reconstruct calibrate SESSION": "calibrate calibration calib",
        "reconstruct, a command of its own": "reconstruct",
        "reconstruct multiview SESSION": "depth depthmap depth-map mesh pointcloud 3d multiview sfm mvs",
        "reconstruct stereo SESSION": "stereo disparity",
        "reconstruct splat SESSION": "splat splats gsplat gaussians train 3dgs",
        "reconstruct panorama SESSION": "panorama stitch pano",
        "reconstruct people SESSION": "people pose poses skeleton mocap joints",
        "reconstruct compare SESSION": "compare evaluate",
        "reconstruct time SESSION": "time align offset offsets",
        "reconstruct board FILE": "board charuco chessboard checkerboard",
        "reconstruct view SESSION": "view walk render bullet-time bullettime",
    },
    "capture-app sessions": {
        "capture-app sessions trash SESSION": "delete rm remove del",
        "capture-app sessions list": "ls dir",
        "capture-app sessions show SESSION": "info inspect describe open view",
        "capture-app sessions rename SESSION NAME": "mv move name",
        "capture-app sessions verify SESSION": "check validate fsck",
        "capture-app sessions repair SESSION": "fix recover resume",
        "capture-app sessions export SESSION": "convert save to",
        "capture-app sessions import SOURCE": "add load read from",
        "capture-app sessions note SESSION TEXT": "annotate comment tag",
        "capture-app sessions restore SESSION": "undelete undo untrash",
        "capture-app sessions empty-trash": "purge clean prune empty",
    },
    "reconstruct": {
        "reconstruct multiview SESSION": "depth depthmap dense mvs pointcloud point-cloud cloud fusion 3d",
        "reconstruct multiview SESSION --mesh": "mesh poisson mesher",
        "reconstruct stereo SESSION": "disparity sgbm pair",
        "reconstruct calibrate SESSION": "sfm mapper calib calibration intrinsics extrinsics poses colmap",
        "reconstruct splat SESSION": "splats gsplat gaussian gaussians splatfacto train 3dgs nerf nerfacto",
        "reconstruct panorama SESSION": "stitch pano stitching",
        "reconstruct view SESSION": "walk play render novel-view bullet-time bullettime wiggle viewer",
        "reconstruct time SESSION": "sync synchronize align offset offsets",
        "reconstruct people SESSION": "pose skeleton mocap joints keypoints motion-capture human body",
        "reconstruct trajectory SESSION": "track ball path",
        "reconstruct compare SESSION": "evaluate eval quality report",
        "reconstruct board FILE": "charuco chessboard checkerboard",
        "reconstruct batch SESSIONS": "all jobs slurm",
        "capture-app sessions import SOURCE": "import",
        "capture-app sessions export SESSION": "export convert",
        "capture-app sessions list": "list ls",
        "capture-app sessions show SESSION": "show info",
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
        "capture-app rig start": "up run launch new",
        "capture-app rig list": "ls ps status show",
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
    "otio": "premiere premiere-pro adobe resolve davinci final-cut avid editor nle",
    "splats": "blender gltf 3dgs gsplat gaussian-splatting gaussians inria postshot brush",
    "pose2sim": "opensim mocap",
    "mcap": "foxglove ros",
    "rrd": "rerun",
    "mp4": "video videos film movie h264",
}
"""Formats of `sessions export`, each with the programs that read it and other words for it."""
_ACTIONS = {
    "capture-app theme": "dark light colour colours color colors night contrast appearance",
    "capture-app rig add": "webcam webcams usb device devices simulated simulate sim node connect",
    "capture-app app quit": "exit close leave",
    "capture-app app help": "keys shortcuts",
    "capture-app cameras set": "shutter iso",
    "capture-app node fps": "fps frame-rate framerate rate hz",
    "capture-app sessions empty-trash": "disk space storage size free",
    "capture-app sessions look": "disk storage size",
    "capture-app sessions sort": "two-takes compare-takes best rank order",
    "capture-app sessions import": "sound audio timecode",
    "capture-app rig remove": "kill stop-camera",
}
"""Actions of the screen that are not commands, written as if they were, with other words for them."""
_OPTIONS = (
    "--frames count n num number num-frames shots burst images vframes",
    "--count n num frames number max-frames vframes",
    "--out output o out-dir output-dir output-path dir dest destination outfile workspace-path to",
    "--to format f type output-format as",
    "--seconds duration t time length for",
    "--interval-s interval timelapse delay",
    "--fps rate framerate frame-rate r hz",
    "--camera device source src input i cam spec cameras",
    "--leader server host address ip connect url",
    "--sessions dir folder out output data output-dir",
    "--name label title tag n",
    "--json output-json as-json machine",
    "--port p listen",
    "--host bind address ip listen",
    "--instant frame frames index at time",
    "--instants frames range",
    "--width size resolution scale res",
    "--cameras count n num devices",
    "--simulated fake sim dummy",
    "--replace overwrite force f y",
    "--yes y force",
    "--jobs j threads workers parallel num-workers",
    "--from method mode using",
    "--square-mm square square-size square-length size",
    "--marker-mm marker marker-size marker-length",
    "--watch follow f w",
    "--stop end finish",
    "--detach d background daemon",
    "--min-nodes min-cameras nodes cameras",
    "--quick fast preview draft quality",
    "--mesh poisson",
    "--iterations steps iters max-iterations",
    "--verbose debug trace log-level",
    "--calibration intrinsics camera-params calib",
    "--every step stride skip",
    "--field-of-view fov hfov",
)
"""Options, each with other programs' words for it, without hyphens; the first that a command has wins."""
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


def advise(error: click.UsageError) -> str:
    """Return the message of a usage error, with what was probably meant by an unknown command or option."""
    if error.ctx is None or not isinstance(error, click.NoSuchOption | click.NoSuchCommand):
        return _in_our_words(error)
    command = error.ctx.command
    if isinstance(error, click.NoSuchOption):
        what, typed, word = "option", error.option_name, error.option_name.lstrip("-").replace("_", "-")
        names = [name for param in command.get_params(error.ctx) for name in param.opts if name[:1] == "-"]
        known = {line.split()[0]: line for line in _OPTIONS if line.split()[0] in names}
    else:
        what, typed, word = "command", error.command_name, error.command_name
        names = command.list_commands(error.ctx) if isinstance(command, click.Group) else []
        known = _COMMANDS.get(error.ctx.command_path, {})
    unknown = f"No such {what} '{typed}'"
    for meant, words in known.items():
        if word.casefold() in words.split():
            return f"{unknown}: it is {meant}"
    close = get_close_matches(typed.casefold(), names, 1, _CLOSE)
    return f"{unknown}. Did you mean '{close[0]}'?" if close else unknown


def _in_our_words(error: click.UsageError) -> str:
    """Return what an option or argument takes, and what it was given, instead of click's sentences."""
    text = error.message.rstrip(".")
    if isinstance(error, click.BadOptionUsage):
        return f"{error.option_name} needs a value" if "requires an argument" in text else text
    if not isinstance(error, click.BadParameter) or error.param is None:
        return _TOO_MANY.sub(r"too many arguments: \1", text)
    name, kind = error.param.get_error_hint(error.ctx).replace("'", ""), error.param.type
    if isinstance(error, click.MissingParameter):
        return f"{name} is missing"
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
