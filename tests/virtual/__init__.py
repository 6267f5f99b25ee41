"""A whole rig in virtual time: leaders, relays and cameras as they are, over a simulated network and disks.

A seed is a fault report: it draws the rig, what is asked of it and what befalls it, and replays exactly.

    python -m tests.virtual SEED            one seed; --verbose shows its log
    python -m tests.virtual 0-299           many, on all cores
    python -m tests.virtual SEED --shrink   the fewest faults and orders that still fail
"""
