"""A recording imported as its only session."""

from collections.abc import Sequence
from pathlib import Path

from capture_app.common.text import Talk
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.recording import import_found
from capture_app.session.reading.reader import Session


def import_one(
    paths: Sequence[str],
    root: Path,
    name: str,
    options: ImportOptions,
    *,
    talk: Talk = lambda said: None,
) -> Session:
    (session,) = import_found(paths, root, name, options, talk=talk)
    return session
