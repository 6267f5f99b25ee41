"""People in 3D: the method, its options and its words."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from reconstruction.common.options import command_flag, flag
from reconstruction.method.interface import Method
from reconstruction.scene.conditions import Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.methods.people.people_result import PeopleResult
    from reconstruction.methods.people.people_scene import PeopleInstant
    from reconstruction.scene.scene import Scene


class PeopleMethod(Method, frozen=True, kw_only=True):
    """Joints of people, or of animals, at one instant by the time of each frame, with an error for each."""

    name = "people"
    study = f"{__package__}.people_study:PeopleStudy"
    made = f"{__package__}.people_result:MadePeople"
    help = (
        "Find the joints of people in SESSION in 3D: as tables, TRC, C3D, glTF and a page.\n\n"
        "Each joint is moved to the instant by the times of the frames around it, so that the cameras may be "
        "staggered, or of different rates. Two cameras at least must see it; each has an error (95 %)."
    )
    examples = (
        "people sessions/walk --out people",
        "people sessions/staggered --rate 120 --film --out people",
        "people sessions/mice --keypoints labels --out mice",
    )
    result_file = "people.json"

    # No option: a motion has many instants.
    instant: int = 0
    instants: Annotated[
        tuple[int, ...] | None,
        command_flag("--instants", metavar="all|K-L,M,...", help="Instants at which people are located."),
    ] = None
    """None or empty = all."""
    detector: Annotated[
        str, command_flag("--detector", metavar="NAME", help="Detector of joints in images.")
    ] = "blazepose"
    model: Annotated[
        str,
        command_flag(
            "--model",
            metavar="NAME",
            show_default="full",
            help="Model of the detector; BlazePose has lite, full and heavy.",
        ),
    ] = ""
    keypoints: Annotated[
        str | None,
        command_flag(
            "--keypoints",
            metavar="FOLDER",
            help="Use joints that another program found: OpenPose's JSON, DeepLabCut's CSV or H5, SLEAP's "
            "analysis H5; a file or folder for each camera.",
        ),
        flag("--keypoints", metavar="FOLDER", help="Compare joints of people that another program found."),
    ] = None
    rate: Annotated[
        float | None,
        command_flag(
            "--rate",
            gt=0,
            le=10_000,
            metavar="HZ",
            show_default="the session's instants",
            help="Locate people so many times a second, instead of at the instants.",
        ),
    ] = None
    nearest: Annotated[
        bool,
        command_flag("--nearest", help="Take the nearest frames as they are, for comparison."),
    ] = False
    smooth: Annotated[
        float | None,
        command_flag(
            "--smooth",
            gt=0,
            le=1000,
            metavar="HZ",
            help="Also write a low-pass filtered copy (Butterworth, no delay); gaps stay gaps.",
        ),
    ] = None
    up: Annotated[
        str,
        command_flag(
            "--up",
            metavar="auto|x|y|z|-x|-y|-z",
            help="Axis of the calibration that points up; auto = the one nearest to the cameras' own.",
        ),
    ] = "auto"
    film: Annotated[
        bool, command_flag("--film", help="Also write a film for each camera, with the joints drawn into it.")
    ] = False
    people: Annotated[bool, flag("--people", help="Compare the joints of people in 3D (longer).")] = False

    def output_folder(self, out: Path) -> "OutputFolder":
        """Return the folder that replaces earlier people; see `Method.output_folder`."""
        from capture_app.session.files.output_folder import OutputFolder, replaces_only
        from reconstruction.methods.people.people_result import OURS

        return OutputFolder(out, replaces_only(OURS | {self.result_file}))

    def require(self) -> None:
        """Refuse to begin without the packages that the files need; see `Method.require`."""
        from capture_app.common.optional_packages import load_optional

        load_optional("ezc3d", "people", "people in 3D")
        if self.film:
            load_optional("av", "export", "a film as MP4")

    def save(self, scene: "Scene", condition: Condition, output: "OutputFolder") -> "PeopleResult":
        """Locate people, and write them in all formats; see `Method.save`."""
        from reconstruction.methods.people.people_result import save_people

        return save_people(scene, condition, output.folder, self)

    def run(self, scene: "Scene", condition: Condition) -> "Iterator[PeopleInstant]":
        """Yield the people at each instant; see `Method.run`."""
        from reconstruction.methods.people.people_scene import instants_of_people

        yield from instants_of_people(scene, condition, self)

    def notes(self, result: Any) -> Iterator[str]:
        """Yield the cameras that were left out, and what else a person should know; see `Method.notes`."""
        yield from super().notes(result)
        yield from result.remarks
