"""Write undistorted images and motion masks: python docs/examples/masked_dataset.py FOLDER [SESSION]."""

import sys
from pathlib import Path

import cv2
import numpy as np

from reconstruction import open_session

folder = Path(sys.argv[1])
session = open_session(sys.argv[2] if len(sys.argv) > 2 else "sample_sessions/jumper")
for name, camera in session.cameras.items():
    folder.joinpath(name).mkdir(parents=True)
    for frame in camera.frames:
        mask = np.where(session.moving(name, frame.instant), 255, 0).astype(np.uint8)
        for kind, image in (("image", frame.bgr()), ("mask", mask)):
            path = folder / name / f"{frame.instant}-{kind}.png"
            cv2.imwrite(str(path), camera.calibration.undistort(image))
print(f"{folder}: {len(session.cameras)} cameras, {len(session.instants)} instants")
