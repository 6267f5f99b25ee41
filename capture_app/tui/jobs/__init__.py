"""Jobs: commands that the screen starts on sessions, one after the other, and what they found.

Knows sessions and their results on disk; no rig. `library` uses it to start commands.
"""
