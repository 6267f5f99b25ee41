"""What share of a recording's frames may be missing without an exit code."""

import pytest

from capture_app.commands.take import require_whole
from capture_app.common.errors import IncompleteError
from capture_app.protocol.status import BurstStatus


def status(received: int) -> BurstStatus:
    return BurstStatus(
        burst=1, name="r", cameras=2, instants=450, received=received, expected=900, done=True, session="s"
    )


def test_few_missing_frames_are_said_and_no_failure(capsys: pytest.CaptureFixture[str]) -> None:
    require_whole("recording", status(900), 1.0)
    assert capsys.readouterr().err == ""
    require_whole("recording", status(899), 1.0)
    assert "1 of 900 frames missing" in capsys.readouterr().err


@pytest.mark.parametrize(("received", "most_missing_pct"), [(890, 1.0), (899, 0.0), (0, 99.0)])
def test_more_than_was_asked_for_is_incomplete(received: int, most_missing_pct: float) -> None:
    with pytest.raises(IncompleteError, match="incomplete"):
        require_whole("recording", status(received), most_missing_pct)
