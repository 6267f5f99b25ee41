"""Jobs: child processes of both commands, in a queue, and what they found.

Knows sessions and their results on disk; no rig. `library` uses it to start jobs.
"""
