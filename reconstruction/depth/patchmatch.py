"""COLMAP's PatchMatch on a CUDA GPU, in an environment and a process of its own.

`pycolmap-cuda12` has pycolmap's import name and aborts the process that calls it without a GPU: it is never
imported here. The GPU is probed by the driver's own tool, and the work is done by another Python.
"""

import os
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from capture_app.errors import NotAvailableError, SimulshotError

ENVIRONMENT = "SIMULSHOT_CUDA_PYTHON"
HINT = (
    "python3 -m venv cuda && cuda/bin/pip install pycolmap-cuda12, then set "
    f"{ENVIRONMENT}=cuda/bin/python; or use --matcher sweep"
)
STDERR = 2
PROGRAM = """
import sys, pycolmap
pycolmap.logging.minloglevel = 2
options = pycolmap.PatchMatchOptions()
options.geom_consistency = True
options.depth_min, options.depth_max = float(sys.argv[2]), float(sys.argv[3])
pycolmap.patch_match_stereo(sys.argv[1], "COLMAP", "option-all", options)
"""


@dataclass(frozen=True)
class CudaGpu:
    """A CUDA GPU and the Python whose pycolmap can use it."""

    name: str
    python: Path


def find_gpu(environment: Mapping[str, str] = os.environ) -> CudaGpu:
    """The first GPU, and the other environment's Python.

    Raises:
        NotAvailableError: there is no GPU, or no environment with `pycolmap-cuda12` is named.
    """
    tool = shutil.which("nvidia-smi", path=environment.get("PATH"))
    no_gpu = NotAvailableError(
        "PatchMatch needs an NVIDIA GPU, and this machine has none", hint="use --matcher sweep"
    )
    if tool is None:
        raise no_gpu
    try:
        asked = subprocess.run(  # noqa: S603
            [tool, "--query-gpu=name", "--format=csv,noheader"], capture_output=True, text=True, timeout=30
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NotAvailableError(f"the GPU does not answer: {error}", hint="use --matcher sweep") from error
    names = asked.stdout.strip().splitlines()
    if asked.returncode != 0 or not names:
        raise no_gpu
    named = environment.get(ENVIRONMENT, "")
    if not named:
        raise NotAvailableError(f"there is a GPU ({names[0]}), but no pycolmap with CUDA", hint=HINT)
    python = Path(named)
    if not python.is_file():
        raise NotAvailableError(f"{ENVIRONMENT} names {python}, which does not exist", hint=HINT)
    return CudaGpu(names[0], python)


def run_patch_match(gpu: CudaGpu, workspace: Path, nearest: float, farthest: float) -> None:
    """Fill a workspace's depth and normal maps between two depths; its messages go to stderr.

    Raises:
        SimulshotError: the other process failed or died.
    """
    command = [str(gpu.python), "-c", PROGRAM, str(workspace), repr(nearest), repr(farthest)]
    done = subprocess.run(command, stdout=STDERR, stderr=subprocess.PIPE, text=True)  # noqa: S603
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        how = f"signal {-done.returncode}" if done.returncode < 0 else f"exit code {done.returncode}"
        raise SimulshotError(
            f"PatchMatch on {gpu.name} ended with {how}: {said[-1] if said else 'no message'}",
            hint="--matcher sweep does without a GPU",
        )
