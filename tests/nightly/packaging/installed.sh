#!/bin/sh
# installed.sh PYTHON WHEEL|SDIST [--capture-only]: installs it into a new environment of that Python, in an empty folder,
# and tries what a user would: both commands, a session that is made there, Python's three lines, and the demo.
set -eu
python=$1 built=$(realpath "$2") extras="[reconstruction]"
[ "${3:-}" != --capture-only ] || extras=""
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export XDG_STATE_HOME="$folder/state" XDG_DATA_HOME="$folder/data"
unset PYTHONPATH
"$python" -m venv env
env/bin/python -m pip install --quiet --disable-pip-version-check "$built$extras"
PATH="$folder/env/bin:$PATH"
capture-app --version
reconstruct --version
simulshot --version
env/bin/python - <<'END'
from capture_app import Rig, open_session

with Rig(cameras=["sim:perfect,scene=bars"], sessions="sessions") as rig:
    rig.wait_until_ready()
    path = rig.burst(2, name="first").folder
(camera,) = open_session(path).cameras.values()
print(camera.frames[1].rgb().shape, camera.frames[1].leader_ns, camera.frames[1].uncertainty_ns)
END
capture-app sessions verify sessions/first-001
[ -z "$extras" ] || capture-app demo --cameras 2 --out demo
echo "ok: $(basename "$built")$extras on $("$python" --version)"
