"""Sessions from strangers: whatever is in them is read, or refused in a sentence."""

import json
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from capture_app.common.errors import SimulshotError
from capture_app.session.format.manifest import MANIFEST
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import judge
from capture_app.session.reading.verify import verify
from tests.unit.session.test_foreign_sessions import changed

NASTY: tuple[Any, ...] = (
    None, True, -1, 0, 2**63, -(2**70), 10**400, 1e308, -1e-308, "", "\x1b[2J", "../..", [], [[]], {}, [1],
)  # fmt: skip


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """All places in plain data; of lists the first only."""
    yield path
    if isinstance(value, dict):
        for key, part in value.items():
            yield from places(part, (*path, key))
    elif isinstance(value, list) and value:
        yield from places(value[0], (*path, 0))


def test_no_value_in_a_manifest_gives_an_error_of_python(session: Session) -> None:
    content = json.loads((session.folder / MANIFEST).read_text())
    opened = 0
    for path in places(content):
        for value in NASTY if path else ():
            (session.folder / MANIFEST).write_text(json.dumps(changed(content, path, value)))
            with suppress(SimulshotError):
                read = Session.open(session.folder)
                opened += 1
                judge(read.manifest)
                verify(read)
    assert opened > 50, "many are merely untrue"
