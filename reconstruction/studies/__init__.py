"""Studies of a comparison; each is a plugin in one module.

They are entry points of the group simulshot.studies in pyproject.toml; nothing imports them by name.
"""
