"""Scripts with which pages draw a scene to walk round, those of live people and those of results."""

from pathlib import Path

WALK = Path(__file__).with_name("walk.js")
"""Moves the eye by fingers and keys, and shows what a painter draws."""
SKELETONS = Path(__file__).with_name("skeletons.js")
"""Draws people as bones and joints, each joint within a ball of its error."""
