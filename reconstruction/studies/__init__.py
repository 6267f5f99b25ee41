"""Studies of a comparison, each a plugin that is described by its one module.

They are entry points of the group simulshot.studies in pyproject.toml; nothing imports them by name.
"""
