"""How the bench of the marked film joins OpenPose's joints into detections."""

import numpy as np

from benchmarks.people.marked_film import JOINTS, PAIRS_OF_JOINTS, SIZE, Candidates, detections

LEG = [JOINTS.index(name) for name in ("CHip", "RHip", "RKnee", "RAnkle", "RHeel")]


def test_the_best_pairs_join_joints_and_a_body_has_each_joint_once() -> None:
    joints = [np.zeros((3, 0)) for _ in JOINTS]
    for place, joint in enumerate(LEG):
        joints[joint] = np.array([[0.2, 0.8], [place / 10, place / 10], [0.9, 0.9]])
    scores = [
        np.zeros((joints[a].shape[1], joints[b].shape[1])) for a, b in zip(*PAIRS_OF_JOINTS, strict=True)
    ]
    for pair in scores:
        pair[...] = np.array([[0.3, 0.9], [0.8, 0.2]])[: pair.shape[0], : pair.shape[1]]
    knee = next(k for k, pair in enumerate(zip(*PAIRS_OF_JOINTS, strict=True)) if pair == (LEG[1], LEG[2]))
    scores[knee] = np.array([[0.9, 0.8], [0.8, 0.1]])
    people = detections(Candidates(joints, scores))
    sides = people.pixels[:, LEG, 0] / (SIZE[0] - 1)
    assert people.pixels.shape[:2] == (2, len(JOINTS))
    crossed, straight = (1, 0, 0, 1, 0), (0, 1, 1, 0, 1)
    assert {tuple(np.round(side).astype(int).tolist()) for side in sides} == {crossed, straight}
    assert (people.confidence > 0).sum() == 2 * len(LEG)
