"""Triangulate a moving point, synchronized and late: python docs/examples/triangulate_point.py [SESSION]."""

import sys

import cv2
import numpy as np

from reconstruction import open_session

session = open_session(sys.argv[1] if len(sys.argv) > 1 else "sample_sessions/jumper")
first, second = list(session.cameras)[:2]
sift, matcher = cv2.SIFT.create(), cv2.BFMatcher(crossCheck=True)
for late in (0, 1):
    (points, words), (others, other_words) = (
        sift.detectAndCompute(session.frame(name, at).bgr(), np.asarray(session.moving(name, at), np.uint8))
        for name, at in ((first, 1), (second, 1 + late))
    )
    best = min(matcher.match(words, other_words), key=lambda match: match.distance)
    pixels = {first: points[best.queryIdx].pt, second: others[best.trainIdx].pt}
    place = session.triangulate(pixels)[0].round(3)
    print(f"{late} instants late: pixel {np.round(pixels[first], 1)} of {first} is at {place} m")
