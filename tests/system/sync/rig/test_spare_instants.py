"""Bursts of cameras that drop frames, in virtual time: spare instants, long bursts, and cancelled ones."""

from tests.unit.sync.rig.test_spare_instants import dropping_rig, is_complete, take


def test_five_cameras_that_drop_a_hundredth_give_whole_bursts() -> None:
    """A simulated rig: without spare instants one burst in five lacks an image."""
    rig = dropping_rig(5, 0.01)
    whole = {0: 0, 5: 0}
    for _ in range(40):
        for spare in whole:
            burst, chosen = take(rig, 5, spare)
            whole[spare] += is_complete(rig, burst, chosen)
    assert whole[5] == 40
    assert whole[0] < 40
