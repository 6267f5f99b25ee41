"""People in 3D: the method, its options and its words."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from capture_app.console.option_rules import Rule
from reconstruction.methods.people.people_options import PeopleOptions
from reconstruction.scene.conditions import Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.methods.people.people_result import PeopleResult
    from reconstruction.methods.people.people_scene import PeopleInstant
    from reconstruction.scene.scene import Scene


class PeopleMethod(PeopleOptions, frozen=True, kw_only=True):
    """Joints of people, or of animals, at one instant by the time of each frame, with an error for each."""

    name = "people"
    study = f"{__package__}.people_study:PeopleStudy"
    made = f"{__package__}.people_result:MadePeople"
    help = (
        "Find the joints of people in SESSION in 3D: as tables, TRC, C3D, glTF and a page.\n\n"
        "Each joint is moved to the instant by the times of the frames around it, so that the cameras may be "
        "staggered, or of different rates. Two cameras at least must see it; each has an error (95 %), or of "
        "detectors whose bias was not measured its precision."
    )
    examples = (
        "people sessions/walk --out people",
        "people sessions/staggered --rate 120 --film --out people",
        "people sessions/mice --keypoints labels --out mice",
    )
    rules = (Rule("--label-start", "--keypoints"), Rule("--detector --model", "!--keypoints"))
    result_file = "people.json"
    ours = f"{__package__}.people_result:OURS"

    def require(self) -> None:
        """Refuse to begin without the package that films need; see `Method.require`."""
        if self.film:
            from capture_app.common.optional_packages import load_optional

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
