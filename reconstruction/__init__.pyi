from os import PathLike

from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.reading.reader import Session
from reconstruction.common.outputs import Made
from reconstruction.compare.comparison import CompareOptions as CompareOptions
from reconstruction.methods.multiview.instant_model import MadeMultiview
from reconstruction.methods.multiview.multiview_method import Multiview as Multiview
from reconstruction.methods.panorama.panorama_method import Panorama as Panorama
from reconstruction.methods.panorama.panorama_run import PanoramaResult
from reconstruction.methods.people.people_method import PeopleMethod
from reconstruction.methods.people.people_result import MadePeople
from reconstruction.methods.splat.splat_method import SplatMethod as SplatMethod
from reconstruction.methods.splat.splat_run import MadeSplat
from reconstruction.methods.stereo.stereo_method import Stereo as Stereo
from reconstruction.methods.stereo.stereo_run import MadeStereo
from reconstruction.methods.view.view_method import ViewMethod as ViewMethod
from reconstruction.methods.view.view_run import MadeView
from reconstruction.reconstructed_session import ReconstructedSession
from reconstruction.scene.calibration_run import CalibrateOptions as CalibrateOptions
from reconstruction.scene.calibration_run import CalibrationSource as CalibrationSource
from reconstruction.scene.conditions import Condition as Condition

class _OurMethods(ReconstructedSession):
    """The session with the types of the methods of this package, which it finds by their entry points."""

    def stereo(
        self,
        options: Stereo | None = None,
        *,
        condition: Condition = ...,
        out: str | PathLike[str] | None = None,
        instant: int = 0,
        pair: tuple[str, str] | None = None,
    ) -> MadeStereo: ...
    def multiview(
        self,
        options: Multiview | None = None,
        *,
        condition: Condition = ...,
        out: str | PathLike[str] | None = None,
    ) -> MadeMultiview: ...
    def panorama(
        self,
        options: Panorama | None = None,
        *,
        condition: Condition = ...,
        out: str | PathLike[str] | None = None,
        instant: int = 0,
        pair: tuple[str, str] | None = None,
        register_at: int | None = None,
    ) -> Made[PanoramaResult]: ...
    def splat(
        self,
        options: SplatMethod | None = None,
        *,
        condition: Condition = ...,
        out: str | PathLike[str] | None = None,
        instant: int = 0,
        instants: tuple[int, ...] | None = None,
        without: tuple[str, ...] = (),
        iterations: int = 50,
        width: int = 960,
        quick: bool = False,
    ) -> MadeSplat: ...
    def view(
        self,
        options: ViewMethod | None = None,
        *,
        condition: Condition = ...,
        out: str | PathLike[str] | None = None,
        instant: int = 0,
        instants: tuple[int, ...] | None = None,
        path: str | tuple[CameraCalibration, ...] = "swing",
        frames: int = 90,
        fps: float = 30.0,
        page: bool = False,
        quick: bool = False,
    ) -> MadeView: ...
    def people(
        self,
        options: PeopleMethod | None = None,
        *,
        condition: Condition = ...,
        out: str | PathLike[str] | None = None,
        instants: tuple[int, ...] | None = None,
        detector: str = "blazepose",
        model: str = "",
        keypoints: str | None = None,
        rate: float | None = None,
        nearest: bool = False,
        smooth: float | None = None,
        up: str = "auto",
        film: bool = False,
    ) -> MadePeople: ...

def open_session(session: str | PathLike[str] | Session) -> _OurMethods: ...
