"""Owners of camera names: the pin of the machine that used each name first, stored in one file."""

from pathlib import Path

from capture_app.trust.state_file import StateFile

FILE = "names.json"


class CameraNames:
    """File that records which machine owns each camera name, shared by all leaders of one user."""

    def __init__(self, folder: Path) -> None:
        """Raises BadInputError if the file is damaged, DiskError if it cannot be read."""
        self._file = StateFile(
            folder / FILE, dict[str, str], {}, "delete it: the first machine to use a name owns it again"
        )
        self.owners = dict(self._file.read())
        """Pin of the machine of each name; the leader changes it, and `keep` stores it."""
        self._stored = dict(self.owners)

    def keep(self) -> None:
        """Store the changes. Raises DiskError if that fails; the next call tries again."""
        if self.owners != self._stored:
            removed = self._stored.keys() - self.owners.keys()
            changed = {name: pin for name, pin in self.owners.items() if self._stored.get(name) != pin}
            self._file.change(lambda all_: {n: p for n, p in all_.items() if n not in removed} | changed)
            self._stored = dict(self.owners)
