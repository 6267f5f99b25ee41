"""Draw the rooms of both packages from the import contracts, and print what each room imports.

`python docs/rooms.py` writes docs/images/rooms.svg. The layers come from pyproject.toml, the description of
each room from the table of docs/architecture.md, the imports from the code.
"""

import re
import sys
import tomllib
from collections import defaultdict
from pathlib import Path
from xml.sax.saxutils import escape

import grimp

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
PICTURE = ROOT / "docs" / "images" / "rooms.svg"
PACKAGES = ("capture_app", "reconstruction")
COLUMN_PX, ROW_PX, GAP_PX, TOP_PX = 760, 44, 8, 44
ROW = re.compile(r"^\| `(?P<room>[\w]+\.[\w]+)` \| (?P<what>[^|]*) \|$", re.M)


def room_of(module: str) -> str:
    """Return the room of a module: its package and folder, or its file where it lies in no folder."""
    package, _, rest = module.partition(".")
    return f"{package}.{rest.partition('.')[0]}" if rest else package


def imports() -> dict[str, set[str]]:
    """Return the rooms that each room imports, those under TYPE_CHECKING included."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    found: dict[str, set[str]] = defaultdict(set)
    for module in graph.modules:
        room = room_of(module)
        others = {room_of(other) for other in graph.find_modules_directly_imported_by(module)}
        # `from capture_app import __version__` imports the package itself.
        found[room] |= others - {room, *PACKAGES}
    return dict(found)


def layers(package: str) -> list[list[str]]:
    """Return the rooms of a package by layer, highest first, as the contract in pyproject.toml has them."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    for contract in contracts:
        if contract["type"] == "layers":
            [container] = contract.get("containers", [""])[:1]
            rows = [re.split(r"\s*[|:]\s*", layer) for layer in contract["layers"]]
            named = [[f"{container}.{room}".strip(".") for room in row] for row in rows]
            if all(room.count(".") == 1 and room.startswith(package) for row in named for room in row):
                return named
    raise LookupError(f"no contract has the layers of {package}")


def described() -> dict[str, str]:
    """Return the description of each room in the table of docs/architecture.md."""
    return {row["room"]: row["what"] for row in ROW.finditer(PAGE.read_text())}


def picture() -> str:
    """Return the picture as SVG: a row for each layer, the highest at the top."""
    words, boxes, height = described(), [], TOP_PX
    for column, package in enumerate(PACKAGES):
        left = 20 + column * (COLUMN_PX + 30)
        boxes.append(f'<text x="{left}" y="28" font-size="18" font-weight="bold">{package}</text>')
        rows = layers(package)
        height = max(height, TOP_PX + len(rows) * (ROW_PX + GAP_PX))
        for at, row in enumerate(rows):
            width = (COLUMN_PX - GAP_PX * (len(row) - 1)) / len(row)
            for place, room in enumerate(row):
                x, y = left + place * (width + GAP_PX), TOP_PX + at * (ROW_PX + GAP_PX)
                name, what = room.partition(".")[2], escape(words.get(room, "").replace("`", ""))
                size = min(11.0, 1.75 * width / max(1, len(what)))
                boxes.append(
                    f'<rect x="{x:.0f}" y="{y}" width="{width:.0f}" height="{ROW_PX}" rx="6" fill="#eef3fb" '
                    f'stroke="#555"/><text x="{x + width / 2:.0f}" y="{y + 19}" font-size="14" '
                    f'text-anchor="middle">{name}</text><text x="{x + width / 2:.0f}" y="{y + 36}" '
                    f'font-size="{size:.1f}" text-anchor="middle" fill="#555">{what}</text>'
                )
    width = 40 + 2 * COLUMN_PX + 30
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height + 10}" fill="#222" '
        'font-family="DejaVu Sans, Verdana, sans-serif">\n<title>Rooms of simulshot by layer</title>\n'
        f'<rect width="{width}" height="{height + 10}" fill="#fff"/>\n' + "\n".join(boxes) + "\n</svg>\n"
    )


if __name__ == "__main__":
    PICTURE.write_text(picture())
    for room, others in sorted(imports().items()):
        sys.stdout.write(f"{room}: {', '.join(sorted(others)) or '-'}\n")
