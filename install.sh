#!/bin/sh
# Puts capture-app and reconstruct on the PATH, in an environment of their own.
#   ./install.sh                  everything
#   ./install.sh --capture-only   without reconstruction: for machines with a camera, small ones too
#   ./install.sh --with EXTRAS    also these extras of pyproject.toml: export, rtsp, plots, pictures, rerun, cluster
#   ./install.sh --remove         take both off again
# uv or pipx does it where one of them is there; else, and for root, it is a virtual environment and two links.
# PYTHON names another Python.
set -eu
cd "$(dirname "$0")"
python=${PYTHON:-python3}
extras=reconstruction,people with="" remove=""
usage() { sed -n '2,6s/^# \{0,1\}//p' "$0" >&2; exit 2; }
while [ $# -gt 0 ]; do
  case $1 in
    --capture-only) extras="" SIMULSHOT_CAPTURE_ONLY=1; export SIMULSHOT_CAPTURE_ONLY ;;
    --with) [ $# -gt 1 ] || usage; with=$2; shift ;;
    --remove) remove=yes ;;
    *) usage ;;
  esac
  shift
done
extras=$(echo "$extras,$with" | sed 's/^,*//; s/,*$//')

if [ "$(id -u)" = 0 ]; then
  home=/opt/simulshot links=/usr/local/bin share=/usr/local/share fish=/usr/local/share/fish/vendor_completions.d
else
  share=${XDG_DATA_HOME:-$HOME/.local/share}
  home=$share/simulshot/program links=$HOME/.local/bin fish=${XDG_CONFIG_HOME:-$HOME/.config}/fish/completions
fi
bash=$share/bash-completion/completions

by=venv
if [ "$(id -u)" != 0 ]; then
  if command -v uv >/dev/null; then by=uv; elif command -v pipx >/dev/null; then by=pipx; fi
fi

if [ -n "$remove" ]; then
  keys=${XDG_DATA_HOME:-$HOME/.local/share}/simulshot/trust
  # What would go on without the program, or fail again and again: it is named, and ended where one wants that.
  units="" rigs=""
  for unit in "${XDG_CONFIG_HOME:-$HOME/.config}"/systemd/user/simulshot-*.service /etc/systemd/system/simulshot-*.service; do
    case $unit in /etc/*) [ "$(id -u)" = 0 ] || continue ;; esac
    [ ! -f "$unit" ] || units="$units $unit"
  done
  for rig in "${XDG_STATE_HOME:-$HOME/.local/state}"/simulshot/rigs/*.json; do
    pid=$(basename "$rig" .json)
    ! grep -q capture_app "/proc/$pid/cmdline" 2>/dev/null || rigs="$rigs $pid"
  done
  [ -z "$units" ] || { echo "cameras that start with this machine:"; printf '  %s\n' $units; } >&2
  [ -z "$rigs" ] || echo "rigs that run in the background, by their processes:$rigs" >&2
  if [ -n "$units$rigs" ]; then
    if [ -t 0 ]; then
      printf 'Stop them, and take the services off? [y/N] ' >&2
      read -r STOP
    fi
    case ${STOP:-} in
      [yY]*)
        for unit in $units; do
          case $unit in /etc/*) user="" ;; *) user=--user ;; esac
          systemctl $user disable --now "$(basename "$unit")" >&2 || true
          rm -f "$unit"
        done
        # What a rig has taken is saved as it ends.
        for pid in $rigs; do kill "$pid" || true; done ;;
      *) echo "they stay as they are; STOP=y ./install.sh --remove ends them" >&2 ;;
    esac
  fi
  case $by in
    uv) uv tool uninstall simulshot || true ;;
    pipx) pipx uninstall simulshot || true ;;
  esac
  for name in capture-app reconstruct simulshot; do
    # Only what points into the environment that is removed.
    case $(readlink "$links/$name" 2>/dev/null) in "$home"/*) rm -f "$links/$name" ;; esac
    rm -f "$bash/$name" "$fish/$name.fish"
  done
  rm -rf "$home"
  echo "removed; sessions and settings are still there" >&2
  [ ! -d "$keys" ] || printf '%s\n' "This machine's key, and the machines that it knows: $keys" \
    "Without them it has to be paired anew. To remove them: rm -r '$keys'" >&2
  exit 0
fi

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
  echo "simulshot needs Python 3.11 or newer; name one: PYTHON=python3.12 ./install.sh" >&2; exit 1; }
what="simulshot${extras:+[$extras]} @ $("$python" -c 'import pathlib; print(pathlib.Path.cwd().as_uri())')"
echo "installing ${extras:-the capture side} (by $by): some minutes, by the network and the disk ..." >&2
case $by in
  uv)
    uv tool install --force --reinstall --python "$python" --constraints constraints.txt "$what"
    links=$(uv tool dir --bin) ;;
  pipx)
    pipx install --force --python "$(command -v "$python")" --pip-args="--constraint '$PWD/constraints.txt'" "$what"
    links=${PIPX_BIN_DIR:-$HOME/.local/bin} ;;
  venv)
    "$python" -c 'import ensurepip, venv' 2>/dev/null || {
      echo "python3-venv is missing. On Debian: apt-get install python3-venv" >&2; exit 1; }
    rm -rf "$home"
    mkdir -p "$(dirname "$home")" "$links"
    "$python" -m venv "$home"
    # Compiled is what is used, below: a third of all there is.
    "$home/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt "$what"
    [ -n "$extras" ] || "$home/bin/python" -m pip uninstall --quiet --yes setuptools pip 2>/dev/null
    for name in capture-app reconstruct simulshot; do ln -sf "$home/bin/$name" "$links/$name"; done
    "$home/bin/python" -c 'import capture_app.tui.app, capture_app.node.camera.camera_node, cv2' ;;
esac

"$links/capture-app" --version >&2
# The weights that find people in images, out of a package of PyPI; the first line of the program names its Python.
case $extras in *people*)
  "$(sed -n '1s/^#!//p' "$links/reconstruct")" -m reconstruction.methods.people.blazepose_weights ||
    echo "everything but finding people works" >&2 ;;
esac
mkdir -p "$bash" "$fish"
for name in capture-app reconstruct; do
  variable=_$(echo "$name" | tr 'a-z-' 'A-Z_')_COMPLETE
  env "$variable=bash_source" "$links/$name" >"$bash/$name" 2>/dev/null || rm -f "$bash/$name"
  env "$variable=fish_source" "$links/$name" >"$fish/$name.fish" 2>/dev/null || rm -f "$fish/$name.fish"
done
case :$PATH: in
  *":$links:"*) ;;
  *) printf '%s\n' "$links is not on your PATH. Type this, and put it into ~/.profile:" \
       "  export PATH=\"$links:\$PATH\"" >&2 ;;
esac
