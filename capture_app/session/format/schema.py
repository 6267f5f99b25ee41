"""The published JSON schema of `session.json`, made from the structs that read it."""

from typing import Any

import msgspec

from capture_app.session.format.manifest import Manifest
from capture_app.text import pretty_json


def session_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of a session's manifest."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "simulshot session manifest (session.json)",
        **msgspec.json.schema(Manifest),
    }


def session_schema_text() -> str:
    """The schema as `docs/session.schema.json` holds it."""
    return pretty_json(session_schema()).decode() + "\n"
