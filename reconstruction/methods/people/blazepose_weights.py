"""Weights of BlazePose: fetched once out of a published package, checked by digest, and then on this machine.

`python -m reconstruction.methods.people.blazepose_weights [lite|full|heavy]` fetches them. NOTICE names their
licence and source.
"""

import hashlib
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import click
from platformdirs import user_data_path

from capture_app.common.errors import NotAvailableError
from capture_app.console.terminal import run_command_line
from capture_app.session.files.durable import write_atomic

FOLDER = "simulshot/blazepose"
DETECTOR, LANDMARKS, FULL = "pose_detection.tflite", "pose_landmark_{}.tflite", "full"
DIGESTS = {
    DETECTOR: "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    "pose_landmark_lite.tflite": "f17bfbecadb61c3be1baa8b8d851cc6619c870a87167b32848ad20db306b9d61",
    "pose_landmark_full.tflite": "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
    "pose_landmark_heavy.tflite": "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe",
}
"""SHA-256 of each file."""
MODELS = (FULL, "lite", "heavy")
"""Landmark models, the default first."""
WHEEL, PACKAGE = "mediapipe==0.10.21", "@mediapipe/pose@0.5.1675469404"
"""Packages with the files: PyPI's has the detector and the full model, npm's the other models."""
PLATFORM = ("manylinux_2_28_x86_64", "x86_64-manylinux_2_28")
"""The wheel of one platform, by pip's name and by uv's, is fetched on all machines."""


def folders() -> Sequence[Path]:
    """Return the folders that may have the weights: this Python's environment first, then the user's."""
    return Path(sys.prefix, "share", FOLDER), user_data_path() / FOLDER


def find_weights(model: str) -> tuple[bytes, bytes]:
    """Return the bytes of the detector and of a landmark model.

    Raises:
        NotAvailableError: a file is not on this machine, or it is damaged; the hint fetches it.
    """
    return _checked(DETECTOR, model), _checked(LANDMARKS.format(model), model)


def _checked(name: str, model: str) -> bytes:
    files = [folder / name for folder in folders() if (folder / name).is_file()]
    data = files[0].read_bytes() if files else b""
    if hashlib.sha256(data).hexdigest() != DIGESTS[name]:
        what = f"{files[0]} is damaged: its digest is not the published file's" if files else ""
        raise NotAvailableError(
            what or f"BlazePose's {name} is not on this machine",
            hint=f"fetch it once, then it works offline: {sys.executable} -m {__spec__.name} {model}",
        )
    return data


def fetch(model: str = FULL) -> Path:
    """Fetch the detector and a landmark model, and return their folder.

    Raises:
        NotAvailableError: they cannot be downloaded, or are not the published files.
    """
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        _run(_wheel_command(scratch), scratch)
        if model != FULL:
            _run(["npm", "pack", "--silent", PACKAGE], scratch)
            for archive in Path(scratch).glob("*.tgz"):
                shutil.unpack_archive(archive, scratch, filter="data")
        files = dict[str, bytes]()
        for name in (DETECTOR, LANDMARKS.format(model)):
            files[name] = next((path.read_bytes() for path in Path(scratch).rglob(name)), b"")
            if hashlib.sha256(files[name]).hexdigest() != DIGESTS[name]:
                raise NotAvailableError(f"the package's {name} is not the published file")
    for folder in folders():
        with suppress(PermissionError):
            folder.mkdir(parents=True, exist_ok=True)
            for name, data in files.items():
                write_atomic(folder / name, data)
            return folder
    raise NotAvailableError(f"no folder for the weights can be written: {', '.join(map(str, folders()))}")


def _wheel_command(target: str) -> list[str]:
    pip, uv = PLATFORM
    if find_spec("pip") is not None:
        python = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--platform", pip]
    else:
        python = ["uv", "pip", "install", "--python-platform", uv]
    same = ["--quiet", "--no-deps", "--only-binary", ":all:", "--python-version", "3.11", "--target", target]
    return [*python, *same, WHEEL]


def _run(command: Sequence[str], folder: str) -> None:
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)  # noqa: S603 - our own
    except FileNotFoundError:
        raise NotAvailableError(
            f"BlazePose's weights cannot be fetched without {command[0]}", hint=f"install {command[0]}"
        ) from None
    if done.returncode:
        said = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:] or ["it failed"]
        raise NotAvailableError(
            f"BlazePose's weights cannot be fetched: {said[0]}",
            hint=f"try it again online: {' '.join(command)}",
        )


@click.command()
@click.argument("model", type=click.Choice(MODELS), default=FULL)
def main(model: str) -> None:
    """Fetch the weights of MODEL once, if they are not here; then BlazePose works offline."""
    try:
        find_weights(model)
    except NotAvailableError:
        fetch(model)
    click.echo(f"BlazePose, {model}: its weights are on this machine", err=True)


if __name__ == "__main__":
    sys.exit(run_command_line(main, __spec__.name, sys.argv[1:]))
