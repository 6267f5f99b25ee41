"""Pictures of the experiments: matplotlib without a screen, an optional extra."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture_app.errors import BadInputError
from capture_app.optional_packages import load_optional

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def require(folder: Path) -> None:
    """Make the folder, before any work is done; raises NotAvailableError and BadInputError."""
    new_figure()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(f"cannot draw into {folder}: {error.strerror}", hint="name a folder") from None


def new_figure(**options: Any) -> "Figure":
    """Return an empty figure; options as of `matplotlib.figure.Figure`. Raises NotAvailableError."""
    load_optional("matplotlib", "plots", "drawing figures")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained", **options)
    FigureCanvasAgg(figure)
    return figure


def save(figure: "Figure", path: Path) -> Path:
    """Write the figure as the suffix says (.png, .jpg or .svg), with the same bytes for the same figure."""
    from matplotlib import rc_context

    nameless = {".png": {"Software": None}, ".svg": {"Date": None}}
    with rc_context({"svg.hashsalt": path.stem}):
        figure.savefig(path, dpi=120, metadata=nameless.get(path.suffix))
    return path
