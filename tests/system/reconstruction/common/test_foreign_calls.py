"""The wall around native libraries: what they raise is ours, what they print is gone."""

import subprocess
import sys
from importlib.util import find_spec

import pytest

SPEAKS = """
import ctypes, sys
from reconstruction.common.native_libraries import claim_output
from reconstruction.common.native_libraries import load_open3d
claim_output()
libc = ctypes.CDLL(None)
libc.printf(b"native chatter\\n")
libc.fflush(None)
load_open3d().io.read_point_cloud("/no/such/cloud.ply")
print('{"json": true}')
"""


def test_nothing_of_theirs_is_on_stdout() -> None:
    # To import it here, too, takes as long as the whole test.
    if find_spec("open3d") is None:
        pytest.skip("open3d has no package for this machine")
    done = subprocess.run([sys.executable, "-c", SPEAKS], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout == '{"json": true}\n'
