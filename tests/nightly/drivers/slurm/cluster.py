"""A SLURM cluster of one machine in a temporary folder: munged, slurmctld and slurmd, until the end."""

import os
import secrets
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "srun", "squeue", "sinfo", "scancel")
START_S = 30.0


def why_not() -> str:
    """Why no cluster can be started here, or nothing."""
    if os.geteuid() != 0:
        return "a SLURM cluster can only be started by root"
    missing = [name for name in PROGRAMS if program(name) is None]
    return f"not installed: {', '.join(missing)} (Debian: slurm-wlm munge)" if missing else ""


def program(name: str) -> str | None:
    """Where a program is; the daemons are not on everybody's path."""
    return shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")


@contextmanager
def cluster(folder: Path) -> Iterator[Path]:
    """A running cluster; yields the path of its slurm.conf, for SLURM_CONF."""
    for name in ("munge", "state", "spool"):
        (folder / name).mkdir(mode=0o755)
    key = folder / "munge" / "key"
    key.write_bytes(secrets.token_bytes(128))
    key.chmod(0o400)
    munge = {
        "key-file": key, "socket": folder / "munge" / "socket", "pid-file": folder / "munge" / "pid",
        "log-file": folder / "munge" / "log", "seed-file": folder / "munge" / "seed",
    }  # fmt: skip
    conf = folder / "slurm.conf"
    conf.write_text(_settings(folder, munge["socket"]))
    environment = {**os.environ, "SLURM_CONF": str(conf)}
    with ExitStack() as stack:
        told = stack.enter_context((folder / "daemons.log").open("ab"))
        commands = [
            ["munged", "--foreground", "--force", *(f"--{name}={path}" for name, path in munge.items())],
            ["slurmctld", "-D", "-c"],
            ["slurmd", "-D", "-c"],
        ]
        for name, *arguments in commands:
            daemon = subprocess.Popen(
                [str(program(name)), *arguments], env=environment, stdout=told, stderr=told
            )
            stack.callback(_end, daemon)
            if name == "munged":
                _until(munge["socket"].exists, folder)
        _until(lambda: _idle(environment), folder)
        yield conf


def _settings(folder: Path, munge: Path) -> str:
    host = socket.gethostname().split(".")[0]
    return f"""ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={_free_port()}
SlurmdPort={_free_port()}
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={munge}
CredType=cred/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SwitchType=switch/none
MpiDefault=none
ReturnToService=2
SchedulerParameters=batch_sched_delay=0,sched_interval=1
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
NodeName={host} NodeAddr=127.0.0.1 CPUs={os.cpu_count()} RealMemory=2000 State=UNKNOWN
PartitionName=test Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _idle(environment: dict[str, str]) -> bool:
    command = ["sinfo", "--noheader", "--format=%T"]
    asked = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return asked.stdout.strip() == "idle"


def _until(ready: object, folder: Path) -> None:
    assert callable(ready)
    last = time.monotonic() + START_S
    while not ready():
        if time.monotonic() > last:
            logs = "\n".join(path.read_text()[-1500:] for path in sorted(folder.glob("*.log")))
            raise RuntimeError(f"the cluster does not start:\n{logs}")
        time.sleep(0.1)


def _end(daemon: "subprocess.Popen[bytes]") -> None:
    daemon.terminate()
    try:
        daemon.wait(10)
    except subprocess.TimeoutExpired:
        daemon.kill()
        daemon.wait()
