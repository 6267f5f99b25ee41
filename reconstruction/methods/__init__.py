"""Methods of reconstruction, a folder each: options, run, score, words, and its part of the report.

They are entry points of the group simulshot.methods in pyproject.toml, and `batch` is one of the group
simulshot.reconstruct_commands; nothing imports them by name, and each can be deleted with its entry point.
"""
