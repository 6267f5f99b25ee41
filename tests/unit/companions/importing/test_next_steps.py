"""Which commands an import prints; tests/system runs each."""

import re
from itertools import product

import pytest

from capture_app.companions.importing.next_steps import STEPS, Situation


def commands(situation: Situation) -> list[str]:
    return [command for _, command, works in STEPS if works(situation)]


@pytest.mark.parametrize(
    ("cameras", "instants", "calibrated", "aligned", "comparable"),
    list(product((1, 2, 3), (1, 9), (False, True), (False, True), (False, True))),
)
def test_the_last_command_needs_nothing_that_is_not_there(
    cameras: int, instants: int, calibrated: bool, aligned: bool, comparable: bool
) -> None:
    *_, last = commands(
        Situation(
            cameras=cameras,
            instants=instants,
            calibrated=calibrated,
            aligned=aligned,
            comparable=comparable,
        )
    )
    assert not re.search(r"\b[A-Z]{3,}\b|--apply", last)
    assert ("sheet" in last) or (cameras > 1 and calibrated and aligned)


def test_who_has_no_calibration_is_shown_how_to_get_one() -> None:
    two = commands(Situation(cameras=2, instants=9, calibrated=False, aligned=False, comparable=True))
    assert [command.split(" {folder}")[0] for command in two] == [
        *["reconstruct calibrate"] * 3,
        "reconstruct time",
        "capture-app sessions sheet",
    ]
    assert "--from board --board COLUMNSxROWS --square-mm MM" in two[0]
    assert "--from PATH" in two[1]
    assert "--field-of-view DEG" in two[2]
    three = commands(Situation(cameras=3, instants=9, calibrated=False, aligned=True, comparable=True))
    assert [command.split(" {folder}")[1] for command in three[1:]] == [" --from PATH", " --out {name}.jpg"]
    assert three[0] == two[0]
    ready = commands(Situation(cameras=3, instants=9, calibrated=True, aligned=True, comparable=True))
    assert ready == ["reconstruct compare {folder} --out {name}-compare"]
