"""The commands `compare` and `tolerance`: the same work on synchronized and on offset frames, side by side.

Runs the other commands' wings as studies; nothing imports it but the command line.
"""
