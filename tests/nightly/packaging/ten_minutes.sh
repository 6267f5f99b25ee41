#!/bin/sh
# ten_minutes.sh RUN...: from the package to a moment, as a newcomer goes, with the seconds of each step. RUN is what
# stands before a command's name: `uvx --from WHEEL`, `pipx run --spec WHEEL`, or `env` where it is installed. Needs tmux.
set -eu
folder=$(mktemp -d)
export HOME="$folder"
cd "$folder"
t() { tmux -L "ten-$$" "$@"; }
trap 't kill-server 2>/dev/null || true; for rig in "$folder"/.local/state/simulshot/rigs/*.json; do
  [ ! -e "$rig" ] || kill "$(basename "$rig" .json)" || true; done; sleep 2; rm -rf "$folder"' EXIT
began=$(date +%s%N) last=$(date +%s%N)
step() { now=$(date +%s%N); printf '%6.1f s  %s\n' "$(echo "$now $last" | awk '{print ($1 - $2) / 1e9}')" "$1"; last=$now; }
shows() { # PATTERN: waits up to 200 s until the screen has it
  n=0
  until t capture-pane -p | grep -qE "$1"; do
    n=$((n + 1)); [ $n -lt 1000 ] || { t capture-pane -p; echo "the screen never had: $1" >&2; exit 1; }; sleep 0.2
  done
}
"$@" simulshot --version >version
step "installed: $(cat version)"
t -f /dev/null new-session -d -x 120 -y 40 "cd '$folder' && $* simulshot"
shows 'Try 5'; step "the screen is open"
t send-keys s; shows '5 of 5 ready'; step "s: a rig of five simulated cameras is ready"
t send-keys 2; shows 'pictures of one instant'; step "2: live pictures"
t send-keys Space; shows '(excellent|good|fair) +[0-9.]+ .s'; step "Space: a take of 40 images is saved, with its verdict"
t kill-server
"$@" reconstruct stereo sessions/burst-001 --instant 3 --out depth >log 2>&1 || { cat log; exit 1; }
step "depth of an instant: $(find depth -type f | wc -l) files"
"$@" reconstruct view sessions/burst-001 --instants 3 --quick --page --frames 8 --out walk >log 2>&1 || { cat log; exit 1; }
step "a page to walk round in: $(find walk -name view.html)"
last=$began; step "together, on $(nproc) processors, load $(cut -d' ' -f1 /proc/loadavg)"
