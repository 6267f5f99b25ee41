"""The table of saved sessions, and what a comparison said of each."""

from pathlib import Path
from statistics import median

from rich.text import Text
from textual.widgets import DataTable

from capture_app.session.format.manifest import Manifest
from capture_app.text import NO_VALUE, duration


def describe_manifest(manifest: Manifest) -> tuple[str, str]:
    """Return a session's images (have/asked), and how far one instant's are apart with the clocks' bound."""
    asked = len(manifest.images) + len(manifest.missing)
    apart = manifest.sync.spread_ns if manifest.sync is not None else ()
    sync = duration(round(median(apart))) if apart else NO_VALUE
    if manifest.sync is not None and manifest.sync.hard_bound_ns is not None:
        sync += f" ±{duration(manifest.sync.hard_bound_ns)}"
    return f"{len(manifest.images)}/{asked}", sync


class SessionsTable(DataTable[Text]):
    """One row a session, newest on top; the cursor chooses the one to compare."""

    def __init__(self, *, id: str) -> None:
        super().__init__(id=id, cursor_type="row", cell_padding=1)
        self._paths: list[Path] = []

    def on_mount(self) -> None:
        """Make the columns."""
        for label in ("session", "images", "apart", "comparison"):
            self.add_column(label, key=label)

    @property
    def selected(self) -> Path | None:
        """The session under the cursor."""
        if not self._paths:
            return None
        return Path(str(self.coordinate_to_cell_key(self.cursor_coordinate).row_key.value))

    def add_session(self, path: Path, images: str, sync: str) -> None:
        """Put a new session on top and choose it."""
        self._paths.append(path)
        cells = [Text(path.name, style="bold"), Text(images), Text(sync), Text("press c", style="dim")]
        self.add_row(*cells, key=str(path))
        self.sort("session", key=lambda cell: str(cell), reverse=True)
        self.move_cursor(row=self.get_row_index(str(path)))

    def show_comparison(self, path: Path, text: str, style: str = "") -> None:
        """Write what the comparison of a session says, or how far it is."""
        self.update_cell(str(path), "comparison", Text(text, style=style), update_width=True)
