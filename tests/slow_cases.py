"""Cases of a slow test: some for every change, the others for `make test KIND=long`."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def slow_or_long(slow: Collection[Any], cases: Iterable[Any]) -> list[Any]:
    """Mark the named cases slow and all others long."""
    marks = {True: pytest.mark.slow, False: pytest.mark.long}
    return [pytest.param(case, marks=marks[case in slow], id=str(case)) for case in cases]
