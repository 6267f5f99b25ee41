"""Draw the error bars of a session's cameras: python docs/examples/error_bars.py PNG [SESSION]."""

import sys

from matplotlib import pyplot

from capture_app import open_session

session = open_session(sys.argv[2] if len(sys.argv) > 2 else "sample_sessions/jumper")
for row, name in enumerate(session.cameras):
    late, error = (session.times(field)[row] / 1000 for field in ("residual_ns", "uncertainty_ns"))
    instants = [instant + row / 9 for instant in range(late.size)]
    pyplot.errorbar(instants, late, error, fmt="o", capsize=3, label=name)
pyplot.gca().set(xlabel="instant", ylabel="residual in µs, with its 95 % uncertainty")
pyplot.legend()
pyplot.savefig(sys.argv[1])
