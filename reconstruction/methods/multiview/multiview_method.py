"""Depth, cloud and mesh from all cameras: the method, its options and its words."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture_app.common.errors import NotApplicableError
from capture_app.common.optional_packages import load_optional, require_reconstruction
from capture_app.session.format.camera_labels import require_camera
from reconstruction.methods.multiview.multiview_options import MultiviewOptions
from reconstruction.scene.conditions import Condition

if TYPE_CHECKING:
    from capture_app.session.files.output_folder import OutputFolder
    from reconstruction.depth.seen_moment import SeenInstant
    from reconstruction.methods.multiview.instant_maps import InstantMaps
    from reconstruction.methods.multiview.result import MultiviewResult
    from reconstruction.scene.scene import Scene


class Multiview(MultiviewOptions, frozen=True, kw_only=True):
    """Depth of all cameras, a fused cloud and a mesh; of many instants, a cloud of each."""

    name = "multiview"
    study = f"{__package__}.multiview_study:MultiviewStudy"
    made = f"{__package__}.instant_model:MadeMultiview"
    help = (
        "Compute depth maps of all cameras at one instant of SESSION, a point cloud and a mesh.\n\n"
        "With --instants, a point cloud of each of many instants, and masks of what moves."
    )
    examples = (
        "multiview sessions/burst-001 --out cloud",
        "multiview sessions/burst-001 --instant 3 --no-mesh --out cloud",
        "multiview sessions/burst-001 --instants all --out clouds",
    )
    result_file = "multiview.json"
    ours = f"{__package__}.result:OURS"

    def require(self) -> None:
        """Refuse without the packages or the GPU that the options need; see `Method.require`."""
        if self.workspace:
            require_reconstruction("pycolmap", "writing COLMAP's workspace")
        if self.refine:
            require_reconstruction("pycolmap", "refining a calibration")
        if self.makes_mesh:
            require_reconstruction("open3d", "making a mesh")
        self.chosen_matcher  # noqa: B018

    def write(self, sources: "Sequence[Path | Scene]", out: Path, condition: Condition) -> Any:
        """Compute one instant, or a sequence, whose folder grows cloud by cloud; see `Method.write`."""
        if self.instants is None:
            return super().write(sources, out, condition)
        from reconstruction.methods.multiview.sequence import model_sequence

        if self.makes_mesh:
            require_reconstruction("open3d", "making meshes")
        if self.rrd:
            load_optional("rerun", "rerun", "the .rrd format")
        scene = self.open_scene(sources[0])
        return model_sequence(self.prepared(scene), out, condition.named(scene.dataset), self)

    def save(self, scene: "Scene", condition: Condition, output: "OutputFolder") -> "MultiviewResult":
        """Compute depth, cloud and mesh of one instant; see `Method.save`."""
        from reconstruction.methods.multiview.input_images import prepare_images
        from reconstruction.methods.multiview.instant_model import model_instant

        inputs, early = prepare_images(self.prepared(scene), self.width), output if self.page else None
        return model_instant(inputs, condition, self.instant, self, output.folder, early=early)

    def prepared(self, scene: "Scene") -> "Scene":
        """Return the scene with the calibration that the options ask for.

        Raises:
            SimulshotError: there is no such calibration, or the session lacks a camera that is left out.
        """
        for text in self.without:
            require_camera(text, scene.dataset.labels, "--without")
        if self.calibrated and scene.given is None:
            raise NotApplicableError(
                "no valid calibration of this rig is known",
                hint="run reconstruct calibrate first",
            )
        if not self.refine:
            return scene
        from reconstruction.methods.multiview.refinement import refine_calibration

        return refine_calibration(scene)

    def run(self, scene: "Scene", condition: Condition) -> "Iterator[InstantMaps]":
        """Yield the depth of each instant; several share what stands still. See `Method.run`."""
        from reconstruction.methods.multiview.input_images import prepare_images
        from reconstruction.methods.multiview.instant_maps import match_instants

        inputs = prepare_images(self.prepared(scene), self.width)
        yield from match_instants(
            inputs, scene.dataset.chosen_instants(self.listed_instants), condition, self
        )

    def see(self, scene: "Scene", condition: Condition) -> "Iterator[SeenInstant]":
        """Yield each instant with depth of all cameras that have it; see `Method.see`."""
        from reconstruction.depth.seen_moment import SeenInstant

        for result in self.run(scene, condition):
            yield SeenInstant(result.instant, result.moment(self.min_evidence), result.left_out)

    def notes(self, result: Any) -> Iterator[str]:
        """Yield the cameras or instants that were left out; see `Method.notes`."""
        if self.instants is None:
            yield from super().notes(result)
            return
        for moment in result.instants:
            if moment.reason:
                yield f"instant {moment.instant} has no cloud: {moment.reason}"
