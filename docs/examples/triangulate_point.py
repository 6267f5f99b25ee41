"""Triangulate a point of a calibrated session: python docs/examples/triangulate_point.py [SESSION]."""

import sys

import cv2
import numpy as np

from capture_app import open_session

session = open_session(sys.argv[1] if len(sys.argv) > 1 else "sample_sessions/jumper")
frames = list(session.instants[0].frames.values())[:2]
cameras = [session.cameras[frame.camera].calibration for frame in frames]

features = [cv2.SIFT_create().detectAndCompute(frame.bgr(), None) for frame in frames]
matches = cv2.BFMatcher(crossCheck=True).match(features[0][1], features[1][1])
best = min(matches, key=lambda match: match.distance)
pixels = [features[0][0][best.queryIdx].pt, features[1][0][best.trainIdx].pt]

# Without the lens, a projection matrix is the pose alone.
rays = [
    cv2.undistortPoints(np.array([[pixel]]), camera.camera_matrix, camera.distortion)
    for pixel, camera in zip(pixels, cameras, strict=True)
]
poses = [camera.cam_from_rig[:3] for camera in cameras]
point = cv2.triangulatePoints(*poses, rays[0][0].T, rays[1][0].T)[:, 0]
place = point[:3] / point[3]
print(f"pixel {np.round(pixels[0], 1)} of {frames[0].camera} is at {place.round(3)} {cameras[0].unit}")
