"""What panels show, and that their markers tell them apart."""

import itertools
import json

import pytest

from capture_app.companions.panel.pattern import (
    MARKER_SIZE,
    PANEL_OF_MARKER,
    PANELS,
    Lamp,
    Panel,
)


def is_lit(lamp: Lamp, tick: int) -> bool:
    return (tick - lamp.start) % lamp.period < lamp.lit


def light(panel: Panel, tick: int) -> tuple[bool, ...]:
    return tuple(is_lit(lamp, tick) for lamp in panel.lamps)


def test_the_papers_panel_lights_a_column_a_tick_and_a_lamp_of_its_row_for_ten() -> None:
    panel = PANELS["led-200us"]
    lamps = panel.lamps
    assert len(lamps) == 110
    for tick in (0, 7, 43, 99, 100):
        on = [lamp for lamp, lit in zip(lamps, light(panel, tick), strict=True) if lit]
        column = {lamp.x for lamp in on if lamp.group == 0}
        row = [lamp.x for lamp in on if lamp.group == 1]
        first = min(lamp.x for lamp in lamps)
        assert column == {first + tick % 10}
        assert row == [first + tick // 10 % 10]
        assert len(on) == 11
    assert panel.cycle_ns == 20_000_000


@pytest.mark.parametrize("name", ["led-200us", "led-pair", "screen-60hz-down"])
def test_no_two_ticks_of_a_cycle_look_alike(name: str) -> None:
    panel = PANELS[name]
    ticks = range(0, panel.cycle_ticks, 7)
    assert len({light(panel, tick) for tick in ticks}) == len(ticks)
    assert light(panel, 3) == light(panel, 3 + panel.cycle_ticks)


@pytest.mark.parametrize("panel", PANELS.values(), ids=str)
def test_nothing_of_a_panel_overlaps(panel: Panel) -> None:
    half = panel.lamp_size / 2
    boxes = [(x, y, x + width, y + height) for x, y, width, height in panel.dark]
    for lamp in panel.lamps:
        assert (
            sum(
                left < lamp.x - half
                and top < lamp.y - half
                and lamp.x + half < right
                and lamp.y + half < bottom
                for left, top, right, bottom in boxes
            )
            == 1
        )
    boxes += [(left, top, left + MARKER_SIZE, top + MARKER_SIZE) for _, left, top in panel.markers]
    for one, other in itertools.combinations(boxes, 2):
        assert one[2] <= other[0] or other[2] <= one[0] or one[3] <= other[1] or other[3] <= one[1]
    for left, top, right, bottom in boxes:
        assert left > 0
        assert top > 0
        assert right < panel.width
        assert bottom < panel.height


def test_each_marker_belongs_to_one_panel() -> None:
    numbers = [number for panel in PANELS.values() for number, _, _ in panel.markers]
    assert len(set(numbers)) == len(numbers)
    assert max(numbers) < 250
    assert min(numbers) >= 50
    assert all(
        PANEL_OF_MARKER.get(number) is panel for panel in PANELS.values() for number, _, _ in panel.markers
    )
    assert PANEL_OF_MARKER.get(3) is None


def test_a_screen_draws_one_edge_before_the_other() -> None:
    down, left = PANELS["screen-60hz-down"], PANELS["screen-120hz-left"]
    assert max(down.lamps, key=lambda lamp: lamp.delay).y == max(lamp.y for lamp in down.lamps)
    assert max(left.lamps, key=lambda lamp: lamp.delay).x == min(lamp.x for lamp in left.lamps)
    assert all(lamp.delay == 0 for lamp in PANELS["led-pair"].lamps)


def test_the_description_is_plain_data_that_draws_the_panel() -> None:
    panel = PANELS["led-pair"]
    told = json.loads(json.dumps(panel.description()))
    tick = 1234
    lit = tuple((tick - lamp["start"]) % lamp["period"] < lamp["lit"] for lamp in told["lamps"])
    assert lit == light(panel, tick)
    assert [len(marker["white"]) for marker in told["markers"]] == [6] * 4
    border = told["markers"][0]["white"][0]
    assert border == [0] * 6
