"""An error of one of several tasks is raised by itself, whichever Python runs."""

import pytest

from capture_app.common.errors import BadInputError, CameraError, ungrouped_errors


def test_the_first_of_this_programs_errors_is_raised_by_itself() -> None:
    inner = ExceptionGroup("of a node", [CameraError("no camera"), BadInputError("fps=0")])
    with pytest.raises(CameraError, match="no camera"), ungrouped_errors():
        raise ExceptionGroup("of all", [inner])


def test_what_is_not_this_programs_stays_in_its_group() -> None:
    group = ExceptionGroup("of all", [CameraError("no camera"), KeyError("a fault")])
    with pytest.raises(ExceptionGroup) as caught, ungrouped_errors():
        raise group
    assert caught.value is group
