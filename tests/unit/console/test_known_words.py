"""First guesses of people who know other programs, and what each is answered with."""

import os
import re
import shlex
from collections import Counter
from pathlib import Path

import click
import pytest

from capture_app.cli import run as run_capture_app
from capture_app.common.errors import ExitCode
from capture_app.common.plugins import plugin_names
from capture_app.console.known_words import _COMMANDS, _OPTIONS, FORMATS, RESULTS
from capture_app.session.exporting.exporter import GROUP
from capture_app.session.reading.reader import no_session
from reconstruction.cli import run as run_reconstruct
from tests.command_lines import every_command

RUN = {"capture-app": run_capture_app, "reconstruct": run_reconstruct}

GUESSES = """
capture-app capture > capture-app burst
capture-app shoot > capture-app burst
capture-app take > capture-app burst
capture-app snapshot > capture-app burst
capture-app trigger > capture-app burst
capture-app video > capture-app record
capture-app stream > capture-app monitor
capture-app grab video > capture-app record
capture-app grab > capture-app burst
capture-app rig record > capture-app record
capture-app join --qr > capture-app phones
capture-app help record > capture-app record --help
reconstruct help people > reconstruct people --help
capture-app sessions help list > capture-app sessions list --help
capture-app mask x > reconstruct movers SESSION --out DIR
reconstruct mask x > reconstruct movers SESSION --out DIR
reconstruct align --gcp x > reconstruct calibrate SESSION --mark CAMERA=X,Y --distance-m M
reconstruct calibrate x --gcp y > --mark CAMERA=X,Y --distance-m M
reconstruct calibrate --print-board > reconstruct board FILE
reconstruct multiview x --format ply > --out DIR, with a PLY in it
reconstruct multiview x --glb > --mesh
capture-app sessions export x --format ply > reconstruct multiview SESSION --out DIR
capture-app sessions export x --format las > reconstruct multiview SESSION --out DIR
capture-app Record > 'record'
capture-app start > capture-app rig start
capture-app up > capture-app rig start
capture-app down > capture-app rig stop
capture-app stop > capture-app rig stop
capture-app ps > capture-app rig list
capture-app ui > capture-app, without a command
capture-app gui > capture-app, without a command
capture-app web > capture-app serve
capture-app server > capture-app leader
capture-app master > capture-app leader
capture-app client > capture-app node --camera SPEC
capture-app join > capture-app node --camera SPEC
capture-app devices > capture-app cameras
capture-app list-devices > capture-app cameras
capture-app webcam > capture-app cameras
capture-app camera > 'cameras'
capture-app exposure > capture-app cameras set exposure=4000, in µs
capture-app focus > capture-app cameras set focus=auto
capture-app config > capture-app cameras set CONTROL=VALUE, such as exposure=4000
capture-app pair > capture-app trust pair LEADER
capture-app login > capture-app trust pair LEADER
capture-app ls > capture-app sessions list
capture-app list > capture-app sessions list
capture-app delete > capture-app sessions trash SESSION
capture-app rm > capture-app sessions trash SESSION
capture-app import > capture-app sessions import SOURCE
capture-app export > capture-app sessions export SESSION --to FORMAT --out DIR
capture-app convert > capture-app sessions export SESSION --to FORMAT --out DIR
capture-app verify > capture-app sessions verify SESSION
capture-app info > capture-app status
capture-app sync > capture-app status
capture-app version > capture-app --version
capture-app help > capture-app --help
capture-app phone > 'phones'
capture-app qr > capture-app phones
capture-app dashboard > capture-app monitor
capture-app calibrate > reconstruct calibrate SESSION
capture-app stereo > reconstruct stereo SESSION --out DIR
capture-app splat > reconstruct splat SESSION --out DIR
capture-app depth > reconstruct multiview SESSION --out DIR
capture-app mesh > reconstruct multiview SESSION --out DIR
capture-app stitch > reconstruct panorama SESSION --out DIR
capture-app compare > reconstruct compare SESSION --out DIR
capture-app time > reconstruct time SESSION
capture-app simulate > capture-app demo
capture-app sim > capture-app demo
capture-app pose > reconstruct people SESSION --out DIR
capture-app depthmap > reconstruct multiview SESSION --out DIR
capture-app play x > capture-app sessions wiggle SESSION
capture-app update > capture-app, by the line that installed it (docs/install.md)
capture-app sync-check > capture-app status
capture-app add-camera x > capture-app cameras add SPEC
capture-app rig add x > capture-app cameras add SPEC, or capture-app node on another machine
capture-app ingest x > capture-app sessions import SOURCE
capture-app tag take1 words > capture-app sessions note SESSION TEXT
capture-app new take1 > capture-app burst --name NAME, or record --name NAME
capture-app watch --trigger motion > capture-app burst --on-motion
capture-app freeze take1 > reconstruct view SESSION --out DIR
capture-app rig status > capture-app status
reconstruct automatic_reconstructor --image_path x > reconstruct multiview SESSION --out DIR
reconstruct feature_extractor --image_path x > reconstruct calibrate SESSION
reconstruct calibrate x --squares 8x11 > --board
capture-app share x > reconstruct view SESSION --page --out DIR
reconstruct scale x > reconstruct calibrate SESSION --mark CAMERA=X,Y --distance-m M
capture-app uninstall > capture-app, by make uninstall or pip uninstall simulshot
capture-app check > capture-app doctor
capture-app check x > capture-app sessions verify SESSION
capture-app timestamps x > capture-app sessions show SESSION
capture-app track x > reconstruct trajectory SESSION --out DIR
capture-app vmc > capture-app people
reconstruct gaussian-splat x > reconstruct splat SESSION --out DIR
reconstruct people x --dlc y > --keypoints
reconstruct people x --fbx > --out DIR, with CSV, TRC, C3D and glTF in it
capture-app sessions export x --colmap > --to colmap
capture-app sessions export x --csv > in each export, as frames.csv
capture-app record --hours 12 > --seconds
reconstruct mocap x > reconstruct people SESSION --out DIR
reconstruct play x > reconstruct view SESSION --out DIR
capture-app reconstruct > reconstruct, a command of its own
capture-app statsu > 'status'
capture-app rcord > 'record'
capture-app arm > capture-app burst --wait-s S
capture-app orbit take1 > reconstruct view SESSION --out DIR
capture-app rosbag take1 > capture-app sessions export SESSION --to mcap --out DIR
reconstruct gait take1 > reconstruct people SESSION --out DIR
capture-app make-board > reconstruct board FILE
capture-app genlock > capture-app status
capture-app timecode > capture-app panel show
capture-app jam > capture-app status
capture-app sync a.mp4 b.mp4 > capture-app sessions import a.mp4 b.mp4
capture-app info take1 > capture-app sessions show SESSION
capture-app intrinsics cam1.mp4 > reconstruct calibrate SESSION
capture-app extrinsics > reconstruct calibrate SESSION
capture-app edl take1 > capture-app sessions export SESSION --to otio --out DIR
capture-app undo > capture-app sessions restore SESSION
capture-app disk > capture-app doctor
capture-app log > capture-app rig list
capture-app settings --fps 240 > capture-app cameras set CONTROL=VALUE, such as exposure=4000
capture-app timelapse > capture-app burst --interval-s S
capture-app motion > capture-app burst --on-motion
capture-app --simulated > --camera sim:phone-a
capture-app node --simulated > --camera sim:phone-a
capture-app rig start --sim > --camera sim:phone-a
capture-app --demo > capture-app demo
reconstruct calibrate x --charuco 8x11 > --board
capture-app --shutter 1/500 > capture-app cameras set exposure=4000, in µs
capture-app burst --fps 120 > capture-app node --camera SPEC,fps=N,width=W
capture-app sessions export x --premiere > --to otio
capture-app sessions import a.mp4 --sync audio > --align
reconstruct triangulate x > reconstruct people SESSION --out DIR
reconstruct --people > reconstruct people
reconstruct --calib c.json x > reconstruct calibrate SESSION
reconstruct volumetric x > reconstruct multiview SESSION --out DIR
reconstruct people x --c3d > --out DIR, with CSV, TRC, C3D and glTF in it
capture-app sessions delete x > capture-app sessions trash SESSION
capture-app sessions rm x > capture-app sessions trash SESSION
capture-app sessions ls > capture-app sessions list
capture-app sessions info x > capture-app sessions show SESSION
capture-app sessions open x > capture-app sessions show SESSION
capture-app sessions mv x y > capture-app sessions rename SESSION NAME
capture-app sessions check x > capture-app sessions verify SESSION
capture-app sessions recover x > capture-app sessions repair SESSION
capture-app sessions convert x > capture-app sessions export SESSION --to FORMAT --out DIR
capture-app sessions add x > capture-app sessions import SOURCE
capture-app sessions undelete x > capture-app sessions restore SESSION
capture-app sessions prune > capture-app sessions empty-trash
capture-app cameras ls > capture-app cameras list
capture-app cameras rm x > capture-app cameras remove NAME
capture-app cameras info x > capture-app cameras show NAME
capture-app cameras connect x > capture-app cameras add SPEC
capture-app rig down > capture-app rig stop
capture-app rig ls > capture-app rig list
capture-app trust revoke x > capture-app trust remove MACHINE
capture-app trust code > capture-app trust invite
capture-app burst --count 5 > --frames
capture-app burst -n 5 > --frames
capture-app burst --num-frames 5 > --frames
capture-app burst --shots 5 > --frames
capture-app burst --timelapse 5 > --interval-s
capture-app burst --server 127.0.0.1:1 > --leader 127.0.0.1:1
capture-app burst --title x > --name
capture-app record --duration 5 > --seconds
capture-app record -t 5 > --seconds
capture-app record --framerate 30 > --fps
capture-app record -r 30 > --fps
capture-app record --background > --detach
capture-app node --device 0 > --camera
capture-app node -i 0 > --camera
capture-app node --host 127.0.0.1 > --leader 127.0.0.1
capture-app leader --framerate 30 > --fps
capture-app leader -p 1 > --port
capture-app sessions export x --format mp4 > --to mp4
capture-app sessions export x -f mp4 > --to mp4
capture-app sessions export x -o y > --out
capture-app sessions import x --output y > --out
capture-app sessions import x --framerate 30 > --fps
capture-app sessions import x --intrinsics y > --calibration
capture-app demo --num 3 > --cameras
reconstruct depth x > reconstruct multiview SESSION --out DIR
reconstruct mvs x > reconstruct multiview SESSION --out DIR
reconstruct mesh x > reconstruct multiview SESSION --mesh --out DIR
reconstruct sfm x > reconstruct calibrate SESSION
reconstruct mapper x > reconstruct calibrate SESSION
reconstruct splatfacto x > reconstruct splat SESSION --out DIR
reconstruct gsplat x > reconstruct splat SESSION --out DIR
reconstruct stitch x > reconstruct panorama SESSION --out DIR
reconstruct walk x > reconstruct view SESSION --out DIR
reconstruct bullet-time x > reconstruct view SESSION --out DIR
reconstruct align x > reconstruct time SESSION
reconstruct track x > reconstruct trajectory SESSION --out DIR
reconstruct charuco x > reconstruct board FILE
reconstruct import x > capture-app sessions import SOURCE
reconstruct version > reconstruct --version
reconstruct stereo x -o y > --out
reconstruct stereo x --frame 3 > --instant
reconstruct multiview x --preview > --quick
reconstruct multiview x --poisson > --mesh
reconstruct calibrate x --mode sfm > --from
reconstruct calibrate x --square-size 30 > --square-mm
reconstruct calibrate x --overwrite > --replace
reconstruct calibrate x --hfov 60 > --field-of-view
reconstruct splat x --steps 7 > --iterations
reconstruct batch x --workers 2 > --jobs
""".strip().splitlines()


@pytest.mark.parametrize("guess", GUESSES)
def test_a_first_guess_is_answered_with_what_is_meant(guess: str, capfd: pytest.CaptureFixture[str]) -> None:
    typed, meant = guess.split(" > ")
    program, *words = shlex.split(typed)
    assert RUN[program](words) == ExitCode.USAGE
    printed = capfd.readouterr()
    answer = f"Did you mean {meant}?" if meant.startswith("'") else f": it is {meant}"
    # Another meaning, or what comes first, may follow.
    assert re.search(rf"{re.escape(answer)}(, or .*|; .*)? \(see ", printed.err)
    assert (printed.out, printed.err.count("\n")) == ("", 1)


FIRST_LINES = """
capture-app -f v4l2 -i /dev/video0 -t 10 out.mp4 > --camera
capture-app -i cam1.mp4 -i cam2.mp4 out.mp4 > capture-app sessions import cam1.mp4 cam2.mp4
capture-app record -vcodec libx264 > capture-app sessions export SESSION --to mp4
capture-app record -s 1920x1080 > capture-app node --camera SPEC,fps=N,width=W
capture-app record --output videos > capture-app rig start --sessions DIR
capture-app record out.mp4 > capture-app sessions export SESSION --to mp4
capture-app record rtsp://192.168.1.10/stream > capture-app node --camera rtsp://192.168.1.10/stream
capture-app record --segment 60 > capture-app record takes --leader, --seconds
capture-app extract_frames clip.mp4 > capture-app sessions import clip.mp4
capture-app --auto-detect > capture-app cameras
capture-app --capture-movie > capture-app record
capture-app --capture-image-and-download > capture-app burst
capture-app --set-config iso=200 > capture-app cameras set gain=2
capture-app --list-ctrls > capture-app cameras controls
capture-app diff take1 take2 > reconstruct compare SESSION --against OTHER --out DIR
capture-app mv take1 take2 > capture-app sessions rename SESSION NAME
capture-app commit -m words > capture-app sessions note SESSION TEXT
capture-app restart > capture-app rig stop, then capture-app rig start
capture-app get nodes > capture-app status
capture-app delete session take1 > capture-app sessions trash SESSION
capture-app connect 192.168.1.20:5555 > --leader 192.168.1.20:5555
capture-app screenrecord --time-limit 10 > capture-app record
capture-app rpicam-still -o test.jpg > capture-app burst
capture-app bag record -a > capture-app record
capture-app nerfstudio take1 > capture-app sessions export SESSION --to nerfstudio
capture-app add_new_videos a.mp4 > capture-app sessions import a.mp4
capture-app startRecording > capture-app record
capture-app takePhoto > capture-app burst
capture-app list_devices > capture-app cameras
capture-app syncvideos a.mp4 b.mp4 > capture-app sessions import a.mp4 b.mp4
capture-app start-capture > capture-app burst
capture-app --mode timelapse > capture-app burst --interval-s S
capture-app burst --mode timelapse > --interval-s
capture-app burst --exposure 5 > capture-app cameras set exposure=4000
capture-app burst --iso 400 > capture-app cameras set gain=2
capture-app cameras set --exposure 100 > capture-app cameras set exposure=4000
capture-app start --cameras 4 > capture-app rig start
capture-app --cam 2 preview > capture-app preview
capture-app /dev/video2 > capture-app node --camera v4l2:/dev/video2, or capture-app cameras
capture-app video0 > capture-app node --camera v4l2:/dev/video0
capture-app 1 > capture-app node --camera webcam:1
capture-app node 1 > 1 is capture-app node --camera webcam:1
capture-app node 192.168.1.20 > 192.168.1.20 is --leader 192.168.1.20
capture-app *.mp4 > capture-app sessions import *.mp4 imports it, then capture-app sessions show SESSION
capture-app sessions show clip.mp4 > footage is imported first: capture-app sessions import clip.mp4
capture-app sessions note take1 two words > put the text in quotes
capture-app sessions upload take1 > capture-app sessions export SESSION
capture-app sessions frobnicate > capture-app sessions takes
capture-app cameras rename cam1 left > capture-app node --name NAME --camera SPEC
capture-app cameras set fps=30 > capture-app node --camera SPEC,fps=N,width=W
capture-app снять > There are capture-app rig start, burst and record
reconstruct ns-train splatfacto --data take1 > reconstruct splat SESSION --out DIR
reconstruct export-to-blender take1 > capture-app sessions export SESSION
reconstruct stereoCameraCalibrator > reconstruct calibrate SESSION
reconstruct cameracalibrator.py --size 8x6 > reconstruct calibrate SESSION
reconstruct analyze_videos config.yaml a.mp4 > capture-app sessions import a.mp4
reconstruct multiview a.mp4 b.mp4 > capture-app sessions import a.mp4 b.mp4
reconstruct multiview a.mp4 b.mp4 c.mp4 d.mp4 --out x > capture-app sessions import a.mp4 b.mp4 c.mp4 ...
reconstruct splat take1 --max-num-iterations 30 > --iterations
reconstruct view take1 --camera-path spiral > --path
reconstruct calibrate take1 --rows 6 > --board
reconstruct compare a b > b is --against b
reconstruct compare a b --out x > write --against b
reconstruct multiview take1 > --out is missing; add --out DIR
capture-app record 30s > (write --seconds 30)
capture-app record for 2 hours > (write --seconds 7200)
capture-app record --duration 2min > it is --seconds 120
capture-app record --fps 30fps > write 30
capture-app burst --timeout 500ms > it is --wait-s 0.5
capture-app burst 120 fps > it is capture-app node --camera SPEC,fps=N,width=W
capture-app burst 10 photos > it is --frames
capture-app burst -t 1/500 > capture-app cameras set exposure=4000
capture-app burst --number 9 --iso 400 --foo > --iso is capture-app cameras set gain=2; --foo is unknown
capture-app --shutter-speed 1/250 --iso 800 burst > burst; --iso is capture-app cameras set gain=2
capture-app node --fps 60 --width 1280 > fps=N,width=W; --width is capture-app node --camera
reconstruct splat x --iterattions 7 --device cuda > Did you mean '--iterations'?; --device is
capture-app no camera found > it is capture-app doctor
capture-app please take a picture > it is capture-app burst (
capture-app stop the recording > it is capture-app record --stop
capture-app see cameras > it is capture-app cameras (
capture-app show me the example > it is capture-app demo
capture-app shoot every 5 minutes > it is capture-app burst --interval-s S
capture-app check synchronization > it is capture-app status
capture-app ssh pi@10.0.0.5 > it is capture-app node --camera SPEC (
capture-app make a video > it is capture-app record (
capture-app export --format trc x > it is reconstruct people SESSION --out DIR
capture-app /? > it is capture-app --help
capture-app /list > it is capture-app sessions list
capture-app join videos a.mp4 b.mp4 > it is capture-app sessions import a.mp4 b.mp4
capture-app "record" "C:/videos/out.mp4" > it is capture-app sessions export SESSION --to mp4 --out DIR (
capture-app "C:\\\\takes" > there is nothing at C:\\takes; the command comes first
reconstruct Pose2Sim.calibration > it is reconstruct calibrate SESSION
reconstruct make splat from x > it is reconstruct splat SESSION --out DIR
reconstruct kalibr_calibrate_cameras --models pinhole > it is reconstruct calibrate SESSION
reconstruct filtering --butterworth 6 > it is reconstruct people SESSION --smooth 6 --out DIR
capture-app config --list > it is capture-app cameras controls
capture-app burst --countdown 3 > it is capture-app burst, after the shell's sleep 10
capture-app slate take > it is capture-app mark TEXT
""".strip().splitlines()


@pytest.mark.parametrize("line", FIRST_LINES)
def test_a_first_line_of_another_program_is_answered(line: str, capfd: pytest.CaptureFixture[str]) -> None:
    typed, meant = line.split(" > ")
    program, *words = shlex.split(typed)
    assert RUN[program](words) in (ExitCode.USAGE, ExitCode.BAD_INPUT)
    printed = capfd.readouterr()
    assert meant in printed.err
    assert (printed.out, printed.err.count("\n")) == ("", 1)


@pytest.mark.parametrize(
    "line",
    [
        "reconstruct take1 --dense > reconstruct multiview sessions/take1 --out DIR",
        "reconstruct -i take1 -o out.ply > reconstruct multiview sessions/take1 --out DIR",
        "reconstruct take1 --output model.glb > reconstruct multiview sessions/take1 --mesh --out DIR",
        "reconstruct --recording-path take1 --export-blender > capture-app sessions export sessions/take1",
        "reconstruct take1 --export trc > reconstruct people sessions/take1",
        "reconstruct take1 to splat > reconstruct splat sessions/take1",
        "capture-app sync take1 > reconstruct time sessions/take1",
        "capture-app check take1 > capture-app sessions verify sessions/take1",
        "capture-app run --rm -it take1 > reconstruct multiview sessions/take1 --out DIR",
        "reconstruct ns-process-data take1 > capture-app sessions export sessions/take1 --to nerfstudio",
        "capture-app sessions\\\\take1 > capture-app sessions show sessions/take1",
        "capture-app list sessions > capture-app sessions list",
        "capture-app pull take1 ./here > capture-app sessions export sessions/take1",
        "capture-app timecode take1 > capture-app sessions show sessions/take1",
        "reconstruct undistort take1 -o out > capture-app sessions export sessions/take1 --to splats",
    ],
)
def test_a_line_with_a_session_is_answered_about_sessions(
    line: str, capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sessions/take1").mkdir(parents=True)
    (tmp_path / "sessions/take1/session.json").write_text("{}")
    typed, meant = line.split(" > ")
    program, *words = shlex.split(typed)
    assert RUN[program](words) == ExitCode.USAGE
    # The first thing that is named is what was meant.
    assert re.search(
        rf"[:;] (it is |the command comes first: ){re.escape(meant)}[., ]", capfd.readouterr().err
    )


@pytest.mark.parametrize(
    "word", ["a" * 10_000, "aB" * 5_000, "\udc80", "/\udcff", "{}", "-", "--=", "", "(?", "\n"]
)
@pytest.mark.parametrize("group", [[], ["sessions"], ["sessions", "show", "x"]])
def test_any_word_is_answered(word: str, group: list[str], capfd: pytest.CaptureFixture[str]) -> None:
    assert run_capture_app([*group, word]) == ExitCode.USAGE
    assert capfd.readouterr().err.startswith("capture-app: error: ")


def test_every_answer_is_a_command_line_of_ours() -> None:
    typed = dict(every_command())
    for answers in (*_COMMANDS.values(), RESULTS):
        for line in answers:
            command = line.split(",")[0].split(" -")[0]
            words = [word for word in command.split() if not (word.isupper() or "=" in word)]
            assert " ".join(words) in typed, line
            options = {name for param in typed[" ".join(words)].params for name in param.opts}
            assert {word for word in line.split() if word.startswith("--")} <= options | {"--help", "--to"}, (
                line
            )


def test_no_known_word_is_a_name_of_ours() -> None:
    for group, answers in _COMMANDS.items():
        command: click.Command = dict(every_command())[group]
        assert isinstance(command, click.Group)
        names = set(command.list_commands(click.Context(command)))
        words = [word for known in answers.values() for word in known.split()]
        assert not names & set(words), group
        # Two meanings are shown.
        assert max(Counter(words).values()) <= 2, group


@pytest.mark.parametrize("group", ["sessions", "cameras", "rig", "trust"])
def test_a_command_without_its_group_is_answered_with_both(
    group: str, capfd: pytest.CaptureFixture[str]
) -> None:
    command = dict(every_command())[f"capture-app {group}"]
    assert isinstance(command, click.Group)
    # More groups have these, and two are answered.
    shared = {"list", "add", "remove", "pair"}
    for name in set(command.list_commands(click.Context(command))) - shared:
        assert run_capture_app([name]) == ExitCode.USAGE
        assert f"capture-app {group} {name}" in capfd.readouterr().err


def test_every_option_that_is_advised_exists() -> None:
    ours = {
        name
        for _, command in every_command()
        for param in command.get_params(click.Context(command))
        for name in param.opts
    }
    assert {line.split()[0] for line in _OPTIONS} <= ours


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("capture-app a.mp4 b.mp4", "'a.mp4' is a file: capture-app sessions import a.mp4 b.mp4 imports it"),
        ("capture-app sessions export x --to fcpxml --out y", "--to otio is for it"),
        ("capture-app sessions export x --to anipose --out y", "--to caliscope is for it"),
        (
            "capture-app sessions export x --to c3d --out y",
            "not a format of images: see reconstruct people SESSION --out DIR",
        ),
        ("capture-app sessions export x --to las --out y", "see reconstruct multiview SESSION --out DIR"),
        ("reconstruct view model.glb", "'model.glb' is a 3D model: Blender shows it"),
        ("capture-app view model.glb", "'model.glb' is a 3D model: Blender shows it"),
        ("capture-app sessions export x --to splats --points=cloud.ply", "--out is missing"),
        ("reconstruct mesh x --output model.obj", "it is reconstruct multiview SESSION --mesh --out DIR"),
        ("reconstruct nowhere/x --scale 1.2", "there is nothing at nowhere/x; the command comes first"),
        (
            "capture-app frobnicate x",
            "There are capture-app rig start, burst and record; capture-app sessions",
        ),
        ("capture-app preview", "CAMERA is missing; capture-app status names those of the rig"),
    ],
)
def test_a_file_or_a_format_is_answered_with_what_is_meant(
    line: str, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    program, *words = shlex.split(line)
    assert RUN[program](words) == ExitCode.USAGE
    assert said in capfd.readouterr().err


def test_a_session_is_its_name_where_nothing_else_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("sessions", "take1").mkdir(parents=True)
    Path("sessions", "take1", "session.json").write_text("no manifest")
    for run, line in (
        (run_capture_app, "sessions show take1"),
        (run_capture_app, "sessions export take1 --to colmap --out out"),
        (run_reconstruct, "calibrate take1"),
        (run_reconstruct, "multiview take1 --out out"),
    ):
        assert run(line.split()) == ExitCode.BAD_INPUT
        assert str(Path("sessions", "take1")) in capfd.readouterr().err
    assert run_capture_app(["sessions", "trash", "take1"]) == ExitCode.OK
    assert not Path("sessions", "take1").exists()


def test_a_bare_name_is_answered_with_the_session_of_that_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for order in (["show", "take1"], ["trash", "take1"]):
        assert run_capture_app(["sessions", *order]) == ExitCode.BAD_INPUT
        assert "capture-app sessions list shows what is there" in capfd.readouterr().err
    Path("take1").mkdir()
    assert run_capture_app(["sessions", "show", "take1"]) == ExitCode.BAD_INPUT
    assert "footage is imported first: capture-app sessions import take1" in capfd.readouterr().err
    Path("sessions", "take1").mkdir(parents=True)
    for order in (["show", "take1"], ["trash", "take1"]):
        assert run_capture_app(["sessions", *order]) == ExitCode.BAD_INPUT
        assert "(it is sessions/take1)" in capfd.readouterr().err


@pytest.mark.parametrize("line", ["reconstruct", "capture-app sessions", "capture-app trust"])
def test_a_group_without_a_command_prints_its_help_as_help(
    line: str, capfd: pytest.CaptureFixture[str]
) -> None:
    program, *words = line.split()
    assert RUN[program](words) == ExitCode.USAGE
    printed = capfd.readouterr().err
    assert printed.startswith(f"Usage: {line} ")
    assert "error:" not in printed
    assert printed.count("\n") > 8


@pytest.mark.parametrize(
    ("word", "meant"), [("premiere", "otio"), ("resolve", "otio"), ("DaVinci", "otio"), ("blender", "splats")]
)
def test_a_program_in_place_of_a_format_is_answered_with_its_format(
    word: str, meant: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run_capture_app(["sessions", "export", "x", "--to", word, "--out", "y"]) == ExitCode.USAGE
    assert f"{word!r} is not a format: --to {meant} is for it" in capfd.readouterr().err


def test_every_format_with_words_is_one_of_ours() -> None:
    assert set(FORMATS) <= set(plugin_names(GROUP))
    words = " ".join(FORMATS.values()).split()
    assert len(words) == len(set(words))
    assert not set(words) & set(plugin_names(GROUP))


@pytest.mark.parametrize("guess", ["node --camera 0", "node --camera webcam"])
def test_a_camera_without_its_kind_is_answered_with_a_spec(
    guess: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run_capture_app([*guess.split(), "--leader", "127.0.0.1:1"]) != ExitCode.OK
    assert "write webcam:" in capfd.readouterr().err


def test_a_word_that_no_file_can_have_is_no_traceback(capfd: pytest.CaptureFixture[str]) -> None:
    assert run_capture_app(["a" * 300]) == ExitCode.USAGE
    assert "No such command" in capfd.readouterr().err


def test_a_session_in_place_of_a_command_is_answered_with_a_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("sessions", "take1").mkdir(parents=True)
    Path("sessions", "take1", "session.json").touch()
    for program, command in (
        ("reconstruct", "reconstruct multiview"),
        ("capture-app", "capture-app sessions show"),
    ):
        assert RUN[program](["take1"]) == ExitCode.USAGE
        assert f"the command comes first: {command} sessions/take1" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("capture-app burst --frames x", "--frames takes a whole number from 1 to 100000, not 'x'"),
        ("capture-app burst --frames 0", "--frames takes a whole number from 1 to 100000, not 0"),
        ("capture-app burst --frames", "--frames needs a value"),
        ("capture-app burst 3 4", "too many arguments: 3 4"),
        ("capture-app node", "--camera is missing; capture-app cameras lists what there is"),
        ("capture-app burst 10", "too many arguments: 10 (write --frames 10)"),
        ("capture-app record 10", "too many arguments: 10 (write --seconds 10)"),
        ("capture-app sessions show", "SESSION is missing"),
        ("capture-app sessions sheet nosuch", "--out is missing"),
        ("reconstruct calibrate x --board axb", "--board: 'axb' is not columns x rows"),
    ],
)
def test_a_usage_error_says_what_is_taken(line: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    command, *arguments = shlex.split(line)
    assert RUN[command](arguments) == ExitCode.USAGE
    assert f"{command}: error: {said}" in capsys.readouterr().err


def test_a_folder_or_a_picture_as_a_command_is_imported_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("photos", "rigs/left"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "a.JPG").touch()
    for typed, answer in (
        ("rigs", "'rigs' is a folder: capture-app sessions import rigs imports it"),
        ("photos", "capture-app sessions import photos/*.JPG imports its pictures as one instant, "),
        ("photos", "capture-app sessions import cam0=photos --fps RATE as one camera's"),
        ("import-photos photos", "it is capture-app sessions import photos"),
        ("a.JPG", "is a file"),
    ):
        assert run_capture_app(typed.split()) == ExitCode.USAGE
        assert answer in capfd.readouterr().err
    (tmp_path / "sessions").mkdir()
    assert run_capture_app(["sessions", "frobnicate"]) == ExitCode.USAGE
    assert "footage" not in capfd.readouterr().err
    assert run_reconstruct(["splat", "photos"]) == ExitCode.USAGE
    assert "footage is imported first: capture-app sessions import photos" in capfd.readouterr().err


def test_of_a_films_line_only_what_is_there_is_imported(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.mp4").touch()
    assert RUN["capture-app"](shlex.split("-i a.mp4 -ss 00:00:00.5 -frames:v 1 a.png")) == ExitCode.USAGE
    printed = capfd.readouterr().err
    assert "capture-app sessions import a.mp4, " in printed
    assert "webcam" not in printed  # a time is no camera's number
    assert RUN["capture-app"](shlex.split("-i a.mp4 -i b.mp4 -c copy out.mp4")) == ExitCode.USAGE
    printed = capfd.readouterr().err
    assert "capture-app sessions import a.mp4" in printed
    assert "-i is" not in printed


def test_the_last_session_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "take one first" in str(no_session(Path("last")))
    for name in ("a", "b"):
        (tmp_path / "sessions" / name).mkdir(parents=True)
        (tmp_path / "sessions" / name / "session.json").touch()
    os.utime(tmp_path / "sessions" / "a", (2e9, 2e9))
    assert str(Path("sessions", "a")) in str(no_session(Path("last")))
