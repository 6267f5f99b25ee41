"""Every mistake: one line on stderr, the right exit code, nothing on stdout, no traceback."""

import os
import pty
import socket
import subprocess
import sys
import threading
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from capture_app.cli import app, run
from capture_app.commands.leader_choice import choose_leader, find_leader, leaders_to_join
from capture_app.commands.node import node
from capture_app.common.address import Address
from capture_app.common.errors import ExitCode, NetworkError
from capture_app.net.server import bind_port
from capture_app.node.camera.device_profiles import DeviceProfiles, node_key
from capture_app.protocol.pairing_messages import FoundLeader
from capture_app.rig.process import recorded_rig
from capture_app.sync.wire.codec import version_answer
from tests.command_lines import PROGRAMS

USAGE, BAD_INPUT = ExitCode.USAGE, ExitCode.BAD_INPUT
NO_CAMERA, NETWORK = ExitCode.NO_CAMERA, ExitCode.NETWORK
NODE = ("node", "--leader", "127.0.0.1:1")
NAMES = app.list_commands(click.Context(app))


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("nonsense",), USAGE, "nonsense"),
        (("status", "--nonsense"), USAGE, "--nonsense"),
        (("status", "--leader", "host:99999"), USAGE, "99999"),
        (("status", "--leader", "127.0.0.1:1"), NETWORK, "no leader at 127.0.0.1:1"),
        (("burst", "--frames", "0"), USAGE, "--frames"),
        (("burst", "--spacing", "x"), USAGE, "--spacing"),
        (("burst", "--leader", "127.0.0.1:1"), NETWORK, "no leader at"),
        (("rig", "stop", "--leader", "127.0.0.1:1"), NETWORK, "capture-app rig list shows what runs here"),
        (("leader", "--port", "70000"), USAGE, "--port"),
        (("leader", "--fps", "0"), USAGE, "--fps"),
        (("leader", "--host", "203.0.113.1", "--port", "0"), NETWORK, "cannot listen on 203.0.113.1"),
        (("node",), USAGE, "--camera"),
        ((*NODE, "--camera", "nonsense"), BAD_INPUT, "nonsense"),
        ((*NODE, "--camera", "sim:nonsense"), BAD_INPUT, "nonsense"),
        ((*NODE, "--camera", "sim:phone-a,colour=red"), BAD_INPUT, "colour"),
        ((*NODE, "--camera", "v4l2:/dev/video-none"), NO_CAMERA, "/dev/video-none"),
        ((*NODE, "--camera", "sim:phone-a", "--clock", "sundial"), BAD_INPUT, "sundial"),
        ((*NODE, "--camera", "sim:phone-a", "--name", "../x"), USAGE, "../x"),
        ((*NODE, "--camera", "sim:phone-a", "--tolerance-us", "0"), USAGE, "--tolerance-us"),
        (("node", "--camera", "sim:phone-a", "--leader", "nobody.invalid"), NETWORK, "nobody.invalid"),
        (("relay",), USAGE, "LEADER"),
        (("relay", "10.0.0.1:port"), USAGE, "not HOST:PORT"),
        (("relay", "127.0.0.1", "--name", "a b"), USAGE, "is not a valid name for a node"),
        (("relay", "127.0.0.1", "--clock", "sundial"), BAD_INPUT, "unknown clock"),
        (("relay", "[::1]:5", "--host", "127.0.0.1", "--port", "0"), NETWORK, "mix IPv4 and IPv6"),
        (("demo", "--cameras", "8"), USAGE, "--cameras"),
        (("demo", "--stagger", "odd"), USAGE, "does not say how to stagger"),
        (("sessions", "show", "nowhere"), BAD_INPUT, "nowhere"),
    ],
)
def test_a_mistake_is_one_line(
    arguments: tuple[str, ...],
    code: ExitCode,
    says: str,
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == code
    printed = capfd.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("capture-app: error: ")
    assert says in printed.err
    assert printed.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [], "nothing half-written"


@pytest.mark.parametrize("command", [("leader",), ("relay", "127.0.0.1")])
def test_a_port_in_use_is_one_line(command: tuple[str, ...], capfd: pytest.CaptureFixture[str]) -> None:
    datagrams, listening = bind_port("127.0.0.1", 0)
    with datagrams, listening:
        port = str(listening.getsockname()[1])
        assert run((*command, "--host", "127.0.0.1", "--port", port)) == NETWORK
    printed = capfd.readouterr().err
    assert f"cannot listen on 127.0.0.1:{port}" in printed
    assert "--port" in printed
    assert printed.count("\n") == 1


def test_sessions_cannot_go_into_a_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert run(("leader", "--port", "0", "--sessions", str(tmp_path / "file"))) == USAGE
    assert "file" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (("statsu",), "status"),
        (("sessions", "verfy"), "verify"),
        (("link", "--trails"), "--trials"),
        (("burst", "--cancle"), "--cancel"),
    ],
)
def test_a_mistyped_name_is_answered_with_the_one_meant(
    arguments: tuple[str, ...], meant: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments) == USAGE
    assert f"Did you mean '{meant}'?" in capfd.readouterr().err


def completing(typed: str) -> dict[str, str]:
    """What a shell sets to have this completed."""
    words = typed.split(" ")
    variable = f"_{words[0].replace('-', '_').upper()}_COMPLETE"
    return {variable: "bash_complete", "COMP_WORDS": typed, "COMP_CWORD": str(len(words) - 1)}


def test_the_shell_completes_what_is_typed() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "capture_app.cli"],
        env={**os.environ, **completing("capture-app st")}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout == "plain,status\n", done.stderr


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("capture-app ", set(NAMES)),
        ("capture-app panel s", {"show", "sketch"}),
        ("capture-app sessions import --fit ", {"exact", "crop", "scale"}),
        ("reconstruct mult", {"multiview"}),
    ],
)
def test_commands_and_choices_are_completed(
    typed: str, offered: set[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in completing(typed).items():
        monkeypatch.setenv(name, value)
    program = typed.partition(" ")[0]
    with pytest.raises(SystemExit):
        PROGRAMS[program].main([], prog_name=program)
    assert {line.partition(",")[2] for line in capsys.readouterr().out.split()} == offered


def test_cameras_are_also_listed_by_that_word(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(("cameras", "list", "--json")) == run(("cameras", "--json")) == ExitCode.OK
    first, second = capfd.readouterr().out.rstrip().split("\n}\n")
    assert f"{first}\n}}" == second


def test_a_table_has_lines_on_a_terminal_only(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(("cameras",)) == ExitCode.OK
    piped = capfd.readouterr().out
    assert piped.splitlines()[0].split() == ["spec", "model", "detail"]
    assert all(line.isprintable() for line in piped.splitlines())
    assert "─" not in piped
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "capture_app.cli", "cameras"]
    environment = {**os.environ, "TERM": "xterm-256color"}
    subprocess.run(command, stdout=theirs, stderr=subprocess.DEVNULL, check=True, env=environment)
    os.close(theirs)
    seen = os.read(ours, 65536).decode()
    os.close(ours)
    assert "─" in seen
    assert "sim:phone-a" in seen
    assert "\\x1b" not in seen, "colours are shown as text"


@pytest.mark.parametrize("command", NAMES)
def test_every_command_explains_itself(command: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert run((command, "--help")) == ExitCode.OK
    assert "Usage: capture-app" in capfd.readouterr().out


def answer_questions(sock: socket.socket) -> None:
    """Tell the version to all who ask, until the socket is shut down."""
    while data := sock.recvfrom(2048):
        answer = version_answer(data[0])
        if answer is None:
            return
        sock.sendto(answer, data[1])


def test_a_node_without_an_address_joins_the_rig_of_its_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    # Whatever leader this machine has at the usual port is not asked.
    monkeypatch.setattr("capture_app.rig.membership.DEFAULT_PORT", 1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        own = Address("127.0.0.1", sock.getsockname()[1])
        answering = threading.Thread(target=answer_questions, args=(sock,))
        answering.start()
        with recorded_rig(own, tmp_path):
            assert find_leader().addresses == (own,)
        sock.sendto(b"end", own)
        answering.join()


def test_a_node_joins_all_leaders_of_the_rig_that_it_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    joining = sys.modules["capture_app.commands.leader_choice"]
    first, second = Address("10.0.0.1", 47010), Address("10.0.0.2", 47010)
    found = FoundLeader("hall-47010", (second,), among=(first, second))
    introduced: list[Address] = []
    monkeypatch.setattr(joining, "find_leader", lambda _: found)
    monkeypatch.setattr(joining, "make_known", lambda leaders, pin, code: introduced.extend(leaders))
    assert leaders_to_join((), None, None) == (first, second)
    assert introduced == [second], "a person is asked for the code of no other"
    assert leaders_to_join((first,), None, None) == (first,)


def test_a_service_waits_for_the_leader_that_its_node_followed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    followed = FoundLeader("studio", (Address("10.0.0.1", 47010),), key="7")
    others = [FoundLeader(name, (Address("10.0.0.2", 47010),), key=name) for name in ("8", "9")]
    answers = [others, others, [followed]]

    async def find(_: object, memory: dict[str, tuple[Address, ...]]) -> list[FoundLeader]:
        assert memory == ({"7": followed.addresses} if name == "cam0" else {})
        return answers.pop(0)

    monkeypatch.setattr("capture_app.rig.membership.find_leaders", find)
    monkeypatch.setattr("sys.stdin.isatty", lambda: False)
    DeviceProfiles().save(node_key("cam0"), followed={"7": followed.addresses})
    name = "cam0"
    assert find_leader(name) is followed
    assert capsys.readouterr().err.count("waiting for it; choose another with --leader") == 1
    name, answers = "new", [others]
    with pytest.raises(NetworkError, match="several leaders"):
        find_leader(name)


def test_of_several_leaders_the_user_names_one() -> None:
    found = [
        FoundLeader("studio-47010", (Address("10.0.0.1", 47010),)),
        FoundLeader("hall-47010", (Address("10.0.0.2", 47010),), is_known=False),
    ]
    assert choose_leader(found[:1], can_ask=False) is found[0]
    with pytest.raises(NetworkError, match=r"several leaders .* 10.0.0.2:47010 \(hall-47010\)"):
        choose_leader(found, can_ask=False)

    @click.command()
    def asking() -> None:
        click.echo(choose_leader(found, can_ask=True).name)

    asked = CliRunner().invoke(asking, input="5\n2\n")
    assert asked.stdout == "hall-47010\n"
    assert "2  10.0.0.2:47010  hall-47010  (not paired)" in asked.stderr
    assert CliRunner().invoke(asking, input="\n").stdout == "studio-47010\n"


def test_a_node_takes_the_leaders_that_it_is_given() -> None:
    given = ("--leader", "10.0.0.1", "--leader", "10.0.0.2:5")
    context = node.make_context("node", ["--camera", "sim:webcam", *given])
    assert [str(leader) for leader in context.params["leaders"]] == ["10.0.0.1:47010", "10.0.0.2:5"]


HEAVY = {"textual", "rich", "numpy", "cv2", "open3d", "pycolmap"}


@pytest.mark.parametrize(
    ("program", "lines", "allowed"),
    [
        (
            "capture_app",
            ("--help", "burst --help", "status --leader 127.0.0.1:1", "sessions --help"),
            set(),
        ),
        ("capture_app", ("cameras",), {"rich"}),
        ("capture_app", ("sessions export --help",), {"numpy"}),
        ("reconstruction", ("--help", "batch --help"), set()),
        # It lists the options of all studies, which their modules have.
        ("reconstruction", ("compare --help",), {"numpy", "cv2"}),
    ],
)
def test_scripting_commands_drag_nothing_heavy_in(
    program: str, lines: tuple[str, ...], allowed: set[str]
) -> None:
    text = (
        f"import sys\nfrom {program}.cli import app\n"
        "from capture_app.console.terminal import run_command_line\n"
        f"for line in {lines!r}:\n    run_command_line(app, 'it', line.split())\n"
        "print('MODULES', *sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    modules = set(done.stdout.rpartition("MODULES")[2].split())
    assert modules & HEAVY <= allowed
    assert program == "reconstruction" or "reconstruction" not in modules
