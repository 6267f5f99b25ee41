"""Triangulate a moving point, synchronized and late: python docs/examples/triangulate_point.py [SESSION]."""

import sys

import cv2
import numpy as np

from reconstruction import open_session

session = open_session(sys.argv[1] if len(sys.argv) > 1 else "sample_sessions/jumper")
first, second = list(session.cameras)[:2]
sift, matcher = cv2.SIFT.create(), cv2.BFMatcher(crossCheck=True)
for late in (0, 1):
    found = []
    for camera, instant in ((first, 1), (second, 1 + late)):
        mask = np.asarray(session.moving(camera, instant), np.uint8)
        found.append(sift.detectAndCompute(session.frame(camera, instant).bgr(), mask))
    (points, words), (others, other_words) = found
    best = min(matcher.match(words, other_words), key=lambda match: match.distance)
    pixels = {first: points[best.queryIdx].pt, second: others[best.trainIdx].pt}
    (place,) = session.triangulate(pixels)
    print(f"{late} instants late: pixel {np.round(pixels[first], 1)} of {first} is at {place.round(3)} m")
