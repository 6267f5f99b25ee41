"""The picture and the truth of a simulated frame, rendered when they are saved."""

import hashlib
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

from capture_app.errors import CameraError
from capture_app.simulation.devices.sensor import SensorFrame
from capture_app.simulation.rendering.picture_source import PictureSource

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

JPEG_QUALITY = 95
DEPTH_STEPS_PER_M = 2048


@dataclass(frozen=True, slots=True)
class SimulatedPicture:
    """A picture that is rendered when it is saved."""

    source: PictureSource
    frame: SensorFrame
    seed: int
    quality: int = JPEG_QUALITY

    @property
    def held_bytes(self) -> int:
        """How much memory it takes: nothing worth counting, before it is rendered."""
        return 0

    def encode(self) -> bytes:
        """Render the frame and return it as JPEG bytes; the same frame gives the same bytes."""
        import cv2

        image = self.source.render(self.frame, seed=self.seed)
        encoded, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self.quality])
        if not encoded:
            raise CameraError(f"a picture of {image.shape} cannot be written as JPEG")
        return data.tobytes()

    def reduced(self, width: int) -> "NDArray[np.uint8]":
        """Render the frame in about that width, more plainly where that is quicker: BGR uint8 (H, W, 3)."""
        return self.source.reduced(self.frame, width, seed=self.seed)


@dataclass(frozen=True, slots=True)
class SimulatedTruth:
    """What the simulator knows of a frame."""

    source: PictureSource
    frame: SensorFrame

    @property
    def true_ns(self) -> int:
        """True start of the first row's exposure, in the host's monotonic clock."""
        return self.frame.start_true_ns

    def encode(self) -> bytes:
        """Return an .npz with `depth_m` (float32 HxW, 0 = none), `objects` (uint8), `movers` (bool).

        Depth is in whole steps of 1/2048 m: a quarter of a millimetre of error for a fifth of the bytes.
        """
        import numpy as np

        exact_m, objects, movers = self.source.ground_truth(self.frame)
        depth_m = np.rint(exact_m * DEPTH_STEPS_PER_M) / np.float32(DEPTH_STEPS_PER_M)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, depth_m=depth_m, objects=objects, movers=movers)
        return buffer.getvalue()


def frame_seed(camera_seed: int, stream: int, sequence: int) -> int:
    """The seed of one frame's noise, 0 to 2**63 - 1: the same frame looks the same in every run."""
    return stable_seed(f"{camera_seed}/{stream}/{sequence}")


def stable_seed(text: str) -> int:
    """A seed, 0 to 2**63 - 1, that is the same for the same text in every run."""
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest()) >> 1
