"""Firewalls, WiFi and leaders: what the doctor says of a network."""

from pathlib import Path

import pytest

from capture_app.common.address import Address
from capture_app.machine import doctor
from capture_app.net.local_network import Firewall, active_firewalls, parse_power_save, wifi_interfaces
from capture_app.trust.trust import Trust
from tests.cheap_rig import start_leader
from tests.unit.net.ports import closed_port

EVERYWHERE = "0.0.0.0"
NFTABLES = "etc/systemd/system/sysinit.target.wants/nftables.service"


def write(root: Path, path: str, text: str = "") -> None:
    file = root / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)


def enable_nftables(root: Path, rules: str) -> None:
    write(root, "etc/nftables.conf", rules)
    (root / NFTABLES).parent.mkdir(parents=True)
    (root / NFTABLES).symlink_to("/lib/systemd/system/nftables.service")


def test_a_machine_without_a_firewall_has_none(tmp_path: Path) -> None:
    write(tmp_path, "etc/ufw/ufw.conf", "# ENABLED=yes would start it\nENABLED=no\n")
    enable_nftables(tmp_path, "table inet filter { chain input { type filter hook input priority 0; } }")
    assert active_firewalls(tmp_path) == []
    (found,) = doctor.firewalls([], [47010])
    assert found.grade == "good"


def test_ufw_needs_the_port_of_a_leader_and_nothing_of_a_node(tmp_path: Path) -> None:
    write(tmp_path, "etc/ufw/ufw.conf", "ENABLED=yes\nLOGLEVEL=low\n")
    active = active_firewalls(tmp_path)
    (found,) = doctor.firewalls(active, [47010])
    assert found.grade == "warning"
    assert "only an administrator sees" in found.text
    assert found.remedy == "sudo ufw allow 47010"
    assert list(doctor.firewalls(active, [])) == []
    write(tmp_path, "etc/ufw/user.rules", "### tuple ### allow any 47010 0.0.0.0/0 any 0.0.0.0/0 in\n")
    assert list(doctor.firewalls(active_firewalls(tmp_path), [47010])) == []
    (other,) = doctor.firewalls(active_firewalls(tmp_path), [47020])
    assert other.remedy == "sudo ufw allow 47020"


def test_a_leader_warns_of_what_keeps_cameras_away_and_of_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "disk", lambda *_, **__: doctor.Finding("disk", "good", "any"))
    assert doctor.warnings_for_leader(EVERYWHERE, 47010, Path("nowhere"), tmp_path) == []
    assert doctor.warnings_for_leader("127.0.0.1", 47010, Path("nowhere"), tmp_path) == []
    write(tmp_path, "etc/ufw/ufw.conf", "ENABLED=yes\n")
    (tmp_path / "sys/class/net/no-such-wlan/phy80211").mkdir(parents=True)
    (warning,) = doctor.warnings_for_leader(EVERYWHERE, 47010, Path("nowhere"), tmp_path)
    assert warning.startswith("ufw is active here, and must allow incoming cameras on port 47010")
    assert warning.endswith(": sudo ufw allow 47010")


def test_firewalld_and_nftables_say_how_they_are_opened(tmp_path: Path) -> None:
    (tmp_path / "run/firewalld").mkdir(parents=True)
    enable_nftables(tmp_path, "chain input { policy drop; }")
    firewalld, nftables = active_firewalls(tmp_path)
    assert (firewalld.name, nftables.name) == ("firewalld", "nftables")
    remedies = [finding.remedy for finding in doctor.firewalls([firewalld, nftables], [47010])]
    assert remedies[0].startswith(
        "sudo firewall-cmd --permanent --add-port=47010/udp --add-port=47010/tcp &&"
    )
    assert remedies[1].startswith("sudo firewall-cmd --permanent --add-port=5353/udp &&")
    assert "port 47010 to /etc/nftables.conf" in remedies[2]


DENIED_IN_UFW = (
    "### tuple ### deny any 47010 0.0.0.0/0 any 0.0.0.0/0 in\n-A ufw-user-input -p udp --dport 47010 -j DROP"
)
REJECTED_IN_FIREWALLD = """<zone><port port="47010" protocol="udp"/>
  <rule family="ipv4">
    <port port="47010" protocol="udp"/>
    <reject/>
  </rule></zone>"""
OPEN_BESIDE_A_DENIAL = """<zone><port port="47010" protocol="udp"/>
  <rule family="ipv4"><port port="22" protocol="tcp"/><drop/></rule></zone>"""


@pytest.mark.parametrize(
    ("rules", "opens"),
    [
        ("### tuple ### allow any 47010 0.0.0.0/0 any 0.0.0.0/0 in", True),
        (DENIED_IN_UFW, False),
        (f"-A ufw-user-input -p udp --dport 47010 -j ACCEPT\n{DENIED_IN_UFW}", True),
        (REJECTED_IN_FIREWALLD, False),
        (OPEN_BESIDE_A_DENIAL, True),
        ("chain input { policy drop; udp dport 47010 accept; tcp dport 23 drop; }", True),
        ("chain input { udp dport { 22, 47010 } drop; }", False),
        ("# cameras come to 47010\nchain input { policy drop; }", False),
    ],
)
def test_a_port_is_open_where_the_first_rule_of_it_lets_it_in(rules: str, opens: bool) -> None:
    assert Firewall("x", "", "", rules).opens(47010) is opens


def test_a_port_is_a_whole_number_in_the_rules() -> None:
    assert Firewall("x", "", "", "allow 147010").opens(47010) is False
    assert Firewall("x", "", "", None).opens(47010) is None


@pytest.mark.parametrize(
    ("told", "saves"), [("Power save: on\n", True), ("Power save: off", False), ("", None), ("nl80211", None)]
)
def test_iw_is_understood(told: str, saves: bool | None) -> None:
    assert parse_power_save(told) is saves


def test_wifi_interfaces_are_told_from_others(tmp_path: Path) -> None:
    (tmp_path / "wlan0" / "phy80211").mkdir(parents=True)
    (tmp_path / "eth0").mkdir()
    assert wifi_interfaces(tmp_path) == ["wlan0"]
    assert wifi_interfaces(tmp_path / "none") == []


async def test_a_leader_in_reach_is_good_and_one_that_is_not_is_a_problem(tmp_path: Path) -> None:
    async with await start_leader(tmp_path) as running:
        assert (await doctor.leader(running.address)).grade == "good"
        own = await doctor.own_rig(running.address)
    assert own.grade == "warning"
    assert "only this machine can reach it" in own.text
    found = await doctor.leader(closed_port())
    assert found.grade == "problem"
    assert "start it there" in found.remedy


async def test_a_rig_that_does_not_answer_is_a_problem() -> None:
    assert (await doctor.own_rig(Address("127.0.0.1", closed_port().port))).grade == "problem"


def test_what_a_machine_goes_by_is_told(tmp_path: Path) -> None:
    assert doctor.trust(Trust.open()).grade == "note"
    own = Trust(tmp_path)
    assert own.identity.pin in doctor.trust(own).text
