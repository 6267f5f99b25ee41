"""Search of a folder for videos and images, equally deep, and what of it an import did not use."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.names import natural_order
from capture_app.common.text import count
from capture_app.session.importing.recording_sources import images_in

MAX_DEPTH = 12
"""Maximum folder depth of a search, such as CAMERA/DCIM/100GOPRO."""
MAX_NAMED = 8
"""Number of files and folders that are named one by one."""


def folders_below(
    folder: Path, depth: int = MAX_DEPTH, seen: frozenset[Path] = frozenset()
) -> Iterator[Path]:
    """Yield a folder and all below it in order, without hidden ones, and each only once along links."""
    # A link that leads in a circle is no folder, and has no real path.
    if not folder.is_dir() or folder.name.startswith(".") or not depth:
        return
    if (own := folder.resolve()) in seen:
        return
    yield folder
    for path in sorted(folder.iterdir(), key=lambda path: natural_order(path.name)):
        yield from folders_below(path, depth - 1, seen | {own})


def image_cameras(folder: Path) -> dict[Path, str]:
    """Return the folders of images below a folder, each with its camera's part of the path.

    Raises BadInputError if no part of the paths tells all cameras apart, as in a folder of several takes.
    """
    paths = [path for path in folders_below(folder) if path != folder and images_in(path)]
    parts = [path.relative_to(folder).parts for path in paths]
    columns = [[own[k] for own in parts] for k in range(min(map(len, parts), default=0))]
    telling = next((column for column in columns if len(set(column)) == len(parts)), None)
    if paths and telling is None:
        some = ", ".join("/".join(own) for own in parts[:3])
        raise BadInputError(
            f"{folder} has {count(len(paths), 'folder')} of images, of several takes or kinds: {some} ...",
            hint="import one take at a time, or name the cameras: NAME=PATH",
        )
    return dict(zip(paths, telling or (), strict=True))


def describe_unused(folder: Path, used: Collection[Path], suffixes: Sequence[str] = ()) -> str:
    """Return a line about the files below a folder that are not used, nor in used folders; '' if none.

    Files of the `suffixes` are not listed.
    """
    whole = {path.resolve() for path in used}
    names: list[str] = []
    for place in folders_below(folder):
        if place.resolve() in whole:
            continue
        files = [
            path
            for path in sorted(place.iterdir(), key=lambda path: natural_order(path.name))
            if path.is_file()
            and not path.name.startswith(".")
            and path.suffix.lower() not in suffixes
            and path.resolve() not in whole
        ]
        inside = place.relative_to(folder)
        kinds = Counter(path.suffix.lower() or "no suffix" for path in files)
        alone = [str(inside / path.name) for path in files if kinds[path.suffix.lower() or "no suffix"] < 3]
        names += alone
        where = "" if place == folder else f"{inside}: "
        names += [f"{where}{n} {kind}" for kind, n in kinds.items() if n >= 3]
    if not names:
        return ""
    more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
    return f"not used: {', '.join(names[:MAX_NAMED])}{more}"
