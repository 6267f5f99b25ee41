"""Take a burst with three simulated cameras: python docs/examples/take_burst.py [FOLDER]."""

import sys

from capture_app import Rig

folder = sys.argv[1] if len(sys.argv) > 1 else "sessions"
with Rig(simulated=3, sessions=folder) as rig:
    rig.wait_until_ready(3)
    burst = rig.burst(frames=5)
spread_us = burst.times("residual_ns").max() / 1000
print(f"{burst.folder}: {len(burst.cameras)} cameras, {len(burst.instants)} instants")
print(f"frames start up to {spread_us:.1f} us after their instant; verdict: {burst.verdict.grade}")
