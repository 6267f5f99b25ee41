"""The cycle code of a screen's panel: it is read as it was drawn, and a damaged one is not read."""

import itertools
import json
import re
import shutil
import subprocess

import pytest

from capture_app.companions.panel.cycle_code import (
    BITS,
    CYCLES,
    PAGES,
    Cycle,
    cell_places,
    decode_cycle,
    encode_cycle,
)
from capture_app.companions.panel.pattern import MARKER_SIZE, PANELS, Panel
from capture_app.companions.panel.screen import HERE, page_html

SCREEN = PANELS["screen-60hz-down"]


def test_every_turn_is_read_as_it_was_drawn_and_no_wrong_cell_goes_unnoticed() -> None:
    for number, page in ((0, 0), (1, 63), (1234, 17), (CYCLES - 1, PAGES - 1)):
        cells = encode_cycle(Cycle(number, page))
        assert decode_cycle(cells) == Cycle(number, page)
        for wrong in itertools.chain(
            itertools.combinations(range(BITS), 1), itertools.combinations(range(BITS), 2)
        ):
            damaged = [cell ^ (k in wrong) for k, cell in enumerate(cells)]
            assert decode_cycle(tuple(damaged)) is None
    assert encode_cycle(Cycle(CYCLES, 5)) == encode_cycle(Cycle(0, 5))


def test_a_page_without_a_code_has_no_turn() -> None:
    assert decode_cycle((0,) * BITS) is None
    assert decode_cycle((1,) * BITS) is None


@pytest.mark.parametrize("panel", [of for of in PANELS.values() if of.is_screen], ids=lambda of: of.name)
def test_cells_are_between_the_markers_and_beside_the_lamps(panel: Panel) -> None:
    others = [(left, top, left + MARKER_SIZE, top + MARKER_SIZE) for _, left, top in panel.markers]
    others += [(left, top, left + width, top + height) for left, top, width, height in panel.dark]
    assert len(set(cell_places(panel))) == BITS
    for x, y in cell_places(panel):
        # With half a pitch of white around: a marker needs it to be found.
        for left, top, right, bottom in others:
            assert x >= right + 0.5 or x + 1 <= left - 0.5 or y >= bottom + 0.5 or y + 1 <= top - 0.5


DRAW = """
const [layout, cycles] = JSON.parse(process.argv[1]);
const canvas = { getContext: () => ({}) };
const drawn = cycles.map(([number, page]) => {
  const drawing = new Drawing(canvas, layout, [], 0.9);
  const cells = [];
  drawing.page = page;
  drawing.fill = (colour, x, y) => cells.push([x, y, colour === "#000" ? 1 : 0]);
  drawing.showTurn(number);
  return cells;
});
console.log(JSON.stringify(drawn));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js")
def test_the_page_draws_the_same_cells() -> None:
    found = re.search(r'id="panels"[^>]*>(.*?)</script>', page_html().decode(), re.DOTALL)
    layout = json.loads(found[1])["layout"]
    cycles = [Cycle(0, 0), Cycle(1, 63), Cycle(2748, 42), Cycle(CYCLES + 3, 9)]
    script = (HERE / "drawing.js").read_text("utf-8") + DRAW
    done = subprocess.run(
        ["node", "-e", script, json.dumps([layout, cycles])], capture_output=True, text=True, check=True
    )
    expected = [
        [[*place, cell] for place, cell in zip(cell_places(SCREEN), encode_cycle(cycle), strict=True)]
        for cycle in cycles
    ]
    assert json.loads(done.stdout) == expected
