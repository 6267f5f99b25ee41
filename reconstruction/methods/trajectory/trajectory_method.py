"""The path of a moving object: the method, its options and its words."""

from typing import TYPE_CHECKING, Annotated

from reconstruction.common.options import command_flag
from reconstruction.method.interface import Method
from reconstruction.scene.conditions import Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.methods.trajectory.trajectory_run import TrajectoryResult
    from reconstruction.scene.scene import Scene


class TrajectoryMethod(Method, frozen=True, kw_only=True):
    """Path of the largest thing that moves, by the time of each frame; the cameras may be staggered."""

    name = "trajectory"
    help = (
        "Follow the largest thing that moves in SESSION through space, such as a thrown ball.\n\n"
        "Each frame counts at its own time, so that a staggered rig of four cameras at 30 follows it at 120 "
        "a second. The cameras must stand still."
    )
    examples = ("trajectory sessions/burst-001 --out path",)
    result_file = "trajectory.json"
    ours = f"{__package__}.trajectory_run:OURS"

    # No option: a path has many instants.
    instant: int = 0
    instants: Annotated[
        tuple[int, ...] | None,
        command_flag("--instants", metavar="all|K-L,M,...", help="Instants in which the object is followed."),
    ] = None
    """None or empty = all."""

    def save(self, scene: "Scene", condition: Condition, output: "OutputFolder") -> "TrajectoryResult":
        """Find the object in all frames, and fit its path; see `Method.save`."""
        from reconstruction.methods.trajectory.trajectory_run import follow

        return follow(scene, self.instants, output.folder, self.progress)
