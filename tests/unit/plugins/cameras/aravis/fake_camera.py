"""A program: aravis's own fake GigE Vision camera on a network interface, until its stdin closes."""

import sys

from capture_app.plugins.cameras.aravis.aravis_device import load_aravis

if __name__ == "__main__":
    camera = load_aravis().GvFakeCamera.new(sys.argv[1], sys.argv[2])
    print("runs" if camera.is_running() else "does not run", flush=True)
    sys.stdin.read()
