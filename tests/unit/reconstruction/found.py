"""What a comparison printed as JSON, by study, measure and condition."""

from typing import Any


def study(result: dict[str, Any], name: str) -> dict[str, Any]:
    """A study of a comparison, or of one of its further conditions."""
    (found,) = (one for one in result["studies"] if one["name"] == name)
    return dict(found)


def values(study: dict[str, Any], side: str = "synced") -> dict[str, float]:
    """The measures of a study in a condition, `synced` or `offset`, that have a value there."""
    return {one["name"]: one[side]["value"] for one in study["measures"] if one[side] is not None}


def changes(study: dict[str, Any]) -> dict[str, dict[str, float]]:
    """The differences of a study's measures, with their intervals."""
    return {one["name"]: one["difference"] for one in study["measures"] if one["difference"] is not None}
