"""Print the error bars of a session's cameras: python docs/examples/error_bars.py [SESSION]."""

import sys

from capture_app import open_session

session = open_session(sys.argv[1] if len(sys.argv) > 1 else "sample_sessions/jumper")
tables = [session.times(name) / 1000 for name in ("residual_ns", "uncertainty_ns", "hard_bound_ns")]
for row, name in enumerate(session.cameras):
    residual, error, bound = (abs(table[row]).max() for table in tables)
    print(f"{name}: within {residual:.0f} us ± {error:.0f} us (95 %), hard bound {bound:.0f} us")
