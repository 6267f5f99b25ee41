"""chrony's reference clock: datagrams of the documented struct, and a real chronyd whose source they are."""

import asyncio
import getpass
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from capture_app.common.tasks import end
from capture_app.companions.sensors.refclock import feed_chrony
from tests.cheap_rig import rig_of
from tests.waiting import until

PATH = f"{os.environ['PATH']}:/usr/sbin"
CHRONYD, CHRONYC = (shutil.which(name, path=PATH) for name in ("chronyd", "chronyc"))


@pytest.mark.skipif(CHRONYD is None or CHRONYC is None, reason="chrony is not installed")
async def test_chronyd_takes_the_rig_as_its_source(tmp_path: Path) -> None:
    """With -x it leaves the system's clock alone."""
    assert CHRONYD is not None
    assert CHRONYC is not None
    samples, control = tmp_path / "rig.sock", tmp_path / "chronyd.sock"
    (tmp_path / "chrony.conf").write_text(
        f"refclock SOCK {samples} refid RIG poll 1 filter 4\n"
        f"bindcmdaddress {control}\npidfile {tmp_path / 'pid'}\ncmdport 0\nport 0\n"
    )
    daemon = await asyncio.create_subprocess_exec(
        CHRONYD, "-x", "-d", "-U", "-u", getpass.getuser(), "-f", str(tmp_path / "chrony.conf")
    )

    def sources() -> str:
        asked = [str(CHRONYC), "-h", str(control), "-c", "sources"]
        return subprocess.run(asked, capture_output=True, text=True, check=False).stdout

    try:
        await until(samples.exists)
        async with rig_of(0, tmp_path / "sessions") as leader:
            feeding = asyncio.create_task(feed_chrony(leader.own_address, samples, every_s=0.25))
            try:
                await until(lambda: sources().startswith("#,*,RIG"))
            finally:
                await end(feeding)
        # Of `chronyc -c sources`: mode, state, name, stratum, poll, reach, age, offset, measured, error.
        fields = sources().strip().split(",")
        assert abs(float(fields[7])) < 0.01
        assert int(fields[5], 8) > 0
    finally:
        daemon.terminate()
        await daemon.wait()
