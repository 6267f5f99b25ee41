"""A node that starts with its machine, as a systemd service."""

import getpass
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from platformdirs import user_config_path

from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.common.text import command_line

_UNIT = """\
[Unit]
Description=simulshot: {title}
StartLimitIntervalSec=0

[Service]
ExecStart={command}
Restart=always
RestartSec=5
# A command line that cannot be right is not tried again.
RestartPreventExitStatus=2 3

[Install]
WantedBy={wanted_by}
"""


@dataclass(frozen=True)
class BootService:
    """Service of one node: of this user, or of the machine if root installs it."""

    name: str
    arguments: tuple[str, ...]
    """Arguments after `capture-app`."""

    @property
    def unit(self) -> str:
        """Name of the systemd unit."""
        return f"simulshot-{self.name}"

    @property
    def path(self) -> Path:
        """Path of the unit file."""
        folder = Path("/etc/systemd/system") if _is_root() else user_config_path("systemd") / "user"
        return folder / f"{self.unit}.service"

    @property
    def log_command(self) -> str:
        """Command that shows the node's log."""
        return f"journalctl {'' if _is_root() else '--user '}-u {self.unit} -f"

    def text(self) -> str:
        """Return the unit file's text; the service uses this Python interpreter, wherever the command is."""
        return _UNIT.format(
            title=f"camera {self.name}",
            # -P: a module in the working directory must not replace one of ours.
            command=" ".join(map(_quoted, (sys.executable, "-P", "-m", "capture_app.cli", *self.arguments))),
            wanted_by="multi-user.target" if _is_root() else "default.target",
        )

    def install(self) -> str:
        """Write the unit file and enable and start the service; return what is left to do, or "".

        Raises:
            NotAvailableError: no systemd serves this user here; nothing is written then.
        """
        if shutil.which("systemctl") is None:
            raise NotAvailableError(
                "systemd is not available on this machine",
                hint="have its own service manager (launchd, Windows' Task Scheduler) start: capture-app "
                + command_line(*self.arguments),
            )
        earlier = self.path.read_text() if self.path.exists() else None
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text(self.text())
        try:
            _systemctl("daemon-reload")
            _systemctl("enable", self.unit)
            _systemctl("restart", self.unit)
        except NotAvailableError:
            if earlier is None:
                self.path.unlink()
            else:
                self.path.write_text(earlier)
            raise
        return "" if _is_root() else _linger()

    def remove(self) -> None:
        """Stop the node and remove the file. Raises BadInputError if there is none, NotAvailableError."""
        if not self.path.exists():
            raise BadInputError(f"{self.name} is not set to start with this machine", hint=f"no {self.path}")
        _systemctl("disable", "--now", self.unit)
        self.path.unlink()
        _systemctl("daemon-reload")


def _is_root() -> bool:
    return hasattr(os, "geteuid") and os.geteuid() == 0  # noqa: TID251 - systemd's machines have it


def _quoted(argument: str) -> str:
    """Quote one argument of ExecStart, with specifiers and variables escaped: systemd.service(5)."""
    text = argument.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{text}"' if not text or set(text) & set(" \t'\";\\") else text


def _systemctl(*arguments: str) -> None:
    command = ("systemctl", *(() if _is_root() else ("--user",)), *arguments)
    done = _run(command)
    if done.returncode:
        raise NotAvailableError(
            f"{' '.join(command)}: {done.stderr.strip() or f'code {done.returncode}'}",
            hint="log in as this user itself, on the machine or by ssh",
        )


def _linger() -> str:
    """Start this user's services without a login; return the command to type if that is not permitted."""
    user = getpass.getuser()
    lingers = _run(("loginctl", "show-user", user, "--property=Linger")).stdout.strip() == "Linger=yes"
    if lingers or _run(("loginctl", "enable-linger")).returncode == 0:
        return ""
    return (
        f"until then it starts when {user} logs in; to start it at boot: sudo loginctl enable-linger {user}"
    )


def _run(command: Sequence[str]) -> "subprocess.CompletedProcess[str]":
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    except OSError as error:
        raise NotAvailableError(
            f"cannot run {command[0]}: {error.strerror}",
            hint="--at-boot needs systemd; otherwise use this machine's own init system",
        ) from error
