"""Run a module of this installation in the background, at a low priority.

    python -m capture_app.common.background NICENESS MODULE ARGUMENT...

It ends with the process that started it. SIGTERM acts as Ctrl-C, so that unfinished results are removed.
"""

import ctypes
import os
import runpy
import signal
import sys


def main() -> None:
    """Run the module named by the second argument."""
    parent = os.getppid()
    # Root's rigs run above the others, and what they start would, too.
    os.nice(max(0, int(sys.argv[1]) - os.nice(0)))
    _end_with(parent)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    del sys.argv[:2]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


def _end_with(parent: int) -> None:
    """Ask Linux to kill this process, even a paused one, when its parent ends; other systems ignore this."""
    if (prctl := getattr(ctypes.CDLL(None), "prctl", None)) is not None:
        prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
        if os.getppid() != parent:  # the parent has ended already
            sys.exit(1)


if __name__ == "__main__":
    main()
