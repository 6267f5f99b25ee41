"""Run a module of this installation in the background, at a low priority.

    python -m capture_app.common.background NICENESS MODULE ARGUMENT...

It ends with the process that started it. A request to end acts as Ctrl-C, so that unfinished results are
removed.
"""

import os
import runpy
import sys

from capture_app.common import system


def main() -> None:
    """Run the module named by the second argument."""
    parent = os.getppid()
    # Root's rigs run above the others, and what they start would, too.
    system.lower_priority(int(sys.argv[1]))
    system.end_with_parent(parent)
    system.end_as_interrupt()
    del sys.argv[:2]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
