"""Studies of a comparison: plugins of the group `simulshot.studies`, each described by its one module.

Nothing imports them by name.
"""
