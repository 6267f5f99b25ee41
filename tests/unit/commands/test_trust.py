"""`capture-app trust`, on two machines that are folders here."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.common.pairing_codes import Role
from capture_app.trust.trust import OPEN_VARIABLE, Trust
from tests.cheap_rig import start_leader

Machine = Callable[..., tuple[int, str, str]]
HERE, THERE = "here", "there"


@pytest.fixture
def on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Machine:
    """Run a command line on one of the machines; return its exit code, stdout and stderr."""

    def run_there(machine: str, *arguments: str, skips_pairing: bool = False) -> tuple[int, str, str]:
        monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / machine))
        monkeypatch.setenv(OPEN_VARIABLE, str(int(skips_pairing)))
        code = run(arguments)
        return code, *capfd.readouterr()

    return run_there


@pytest.fixture
def trust(tmp_path: Path) -> Trust:
    """What the machine here goes by."""
    return Trust(tmp_path / HERE / "simulshot" / "trust")


def listed(on: Machine, machine: str) -> Any:
    return json.loads(on(machine, "trust", "list", "--json")[1])


def test_pins_are_added_listed_and_removed(on: Machine) -> None:
    pin = listed(on, THERE)["pin"]
    assert on(HERE, "trust", "add", pin.upper(), "--name", "garage", "--as", "operator")[0] == ExitCode.OK
    (machine,) = listed(on, HERE)["machines"]
    assert (machine["pin"], machine["name"], machine["roles"]) == (pin, "garage", ["operator"])
    assert pin in on(HERE, "trust", "list")[1]
    assert on(HERE, "trust", "remove", "garage")[0] == ExitCode.OK
    assert listed(on, HERE)["machines"] == []
    code, _, said = on(HERE, "trust", "remove", "garage")
    assert code == ExitCode.BAD_INPUT
    assert "capture-app trust list" in said


@pytest.mark.parametrize(
    "arguments",
    [
        ("trust", "add", "nonsense"),
        ("trust", "pair", "127.0.0.1", "--code", "123"),
        ("trust", "pair", "127.0.0.1"),
        ("trust", "invite", "--as", "leader"),
        ("node", "--camera", "sim:phone-a", "--pin", "nonsense"),
    ],
)
def test_what_cannot_be_read_is_a_mistake_of_usage(on: Machine, arguments: tuple[str, ...]) -> None:
    assert on(HERE, *arguments)[0] == ExitCode.USAGE


async def test_an_invitation_makes_another_machine_an_operator(
    on: Machine, trust: Trust, tmp_path: Path
) -> None:
    async with await start_leader(tmp_path / "s", trust=trust) as leader:
        address = str(leader.own_address)

        async def there(*arguments: str, skips_pairing: bool = False) -> tuple[int, str, str]:
            return await asyncio.to_thread(on, THERE, *arguments, skips_pairing=skips_pairing)

        code, _, said = await there("status", "--leader", address)
        assert code == ExitCode.NETWORK
        assert f"capture-app trust pair {address}" in said
        invited = await asyncio.to_thread(
            on, HERE, "trust", "invite", "--as", "operator", "--leader", address, "--json"
        )
        invitation = json.loads(invited[1])
        assert invitation["join_with"].startswith("capture-app trust pair ")
        code, _, said = await there("trust", "pair", address, "--code", "00000000")
        assert (code, "wrong pairing code" in said) == (ExitCode.NETWORK, True)
        code, said, _ = await there("trust", "pair", address, "--code", invitation["code"], "--json")
        assert json.loads(said)["roles"] == [Role.OPERATOR]
        code, said, _ = await there("status", "--leader", address, "--json")
        assert (code, json.loads(said)["nodes"]) == (ExitCode.OK, [])
        code, _, said = await there("status", "--leader", address, skips_pairing=True)
        assert (code, f"unset {OPEN_VARIABLE}" in said) == (ExitCode.NETWORK, True)


async def test_an_open_rig_asks_nobody_and_has_no_codes(on: Machine, tmp_path: Path) -> None:
    async with await start_leader(tmp_path / "s", trust=Trust.open()) as leader:
        address = str(leader.own_address)
        code, _, _ = await asyncio.to_thread(on, THERE, "status", "--leader", address, skips_pairing=True)
        assert code == ExitCode.OK
        code, _, said = await asyncio.to_thread(on, THERE, "status", "--leader", address)
        assert (code, "does not prove its identity" in said, OPEN_VARIABLE in said) == (
            ExitCode.NETWORK,
            True,
            False,
        )
        invite = ("trust", "invite", "--leader", address)
        code, _, said = await asyncio.to_thread(on, THERE, *invite, skips_pairing=True)
        assert (code, "without a code" in said) == (ExitCode.NETWORK, True)
