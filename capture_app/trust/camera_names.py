"""Whose camera each name is: the pin of the machine that had it first, kept in one file for good."""

from pathlib import Path

from capture_app.trust.kept_file import KeptFile

FILE = "names.json"


class CameraNames:
    """The file of them, which all leaders of one user share."""

    def __init__(self, folder: Path) -> None:
        """Raises BadInputError where the file is damaged, DiskError where it cannot be read."""
        self._file = KeptFile(
            folder / FILE, dict[str, str], {}, "delete it: cameras keep their names from then on"
        )
        self.owners = dict(self._file.read())
        """The pin of each name's machine: to be changed by whoever leads, and kept by `keep`."""
        self._kept = dict(self.owners)

    def keep(self) -> None:
        """Put on disk what has changed. Raises DiskError where that cannot be; it is tried again then."""
        if self.owners != self._kept:
            gone = self._kept.keys() - self.owners.keys()
            news = {name: pin for name, pin in self.owners.items() if self._kept.get(name) != pin}
            self._file.change(lambda all_: {n: p for n, p in all_.items() if n not in gone} | news)
            self._kept = dict(self.owners)
