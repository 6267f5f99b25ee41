import pytest

from capture_app.companions.interop.app_protocol import (
    PERIOD_NS,
)
from tests.unit.companions.interop.test_app_leader import TARGET_NS, grid_instant, rig_of, wait_until_synced


def test_a_fast_phone_has_the_time_for_five_minutes() -> None:
    rig = rig_of(20.0)
    wait_until_synced(rig)
    for _ in range(600):
        rig.run(0.5)
        (phone,) = rig.phones
        (status,) = rig.leader.statuses(rig.now_ns)
        assert status.uncertainty_ns is not None
        assert status.hard_bound_ns is not None
        assert abs(rig.error_ns(phone)) < status.uncertainty_ns < status.hard_bound_ns
        assert abs(rig.error_ns(phone)) < TARGET_NS
        assert rig.says_synced(phone)
    assert status.skew_ppm == pytest.approx(20.0, abs=1.0)
    assert abs(rig.error_ns(phone)) < status.uncertainty_ns
    # With the first offset alone it would be 6 ms off by now.
    assert phone.offsets > 250


def test_lost_messages_cost_no_accuracy() -> None:
    rig = rig_of(-35.0, loss=0.1)
    wait_until_synced(rig)
    for _ in range(60):
        rig.run(0.5)
        assert abs(rig.error_ns(rig.phones[0])) < 2 * TARGET_NS


def test_aligned_phones_take_one_picture_each_near_the_instant() -> None:
    rig = rig_of(20.0, -15.0, aligns=True, loss=0.1)
    wait_until_synced(rig)
    rig.run(10.0)
    instant_ns = grid_instant(rig, 1.0)
    assert rig.leader.order_stills([instant_ns], PERIOD_NS, rig.now_ns) == (instant_ns,)
    rig.turn()
    rig.run(2.0)
    for phone in rig.phones:
        (picture,) = phone.pictures
        assert abs(picture.true_ns - instant_ns) < 300_000
        assert abs(picture.leader_ns - picture.true_ns) < TARGET_NS


def test_no_phone_moves_its_phase_near_a_picture() -> None:
    rig = rig_of(20.0, aligns=True)
    wait_until_synced(rig)
    rig.run(12.0)
    before = rig.phones[0].alignments
    assert before >= 2
    rig.leader.order_stills([grid_instant(rig, 20.0)], PERIOD_NS, rig.now_ns)
    rig.run(16.5)
    assert rig.phones[0].alignments > before
    before = rig.phones[0].alignments
    rig.run(4.0)
    assert rig.phones[0].alignments == before
    rig.run(8.0)
    assert rig.phones[0].alignments > before


def test_phones_record_and_stay_as_they_are_meanwhile() -> None:
    rig = rig_of(20.0, aligns=True)
    wait_until_synced(rig)
    rig.leader.record(True)
    rig.turn()
    rig.run(1.0)
    before = rig.phones[0].alignments
    rig.run(15.0)
    assert rig.phones[0].alignments == before
    rig.leader.record(False)
    rig.leader.set_exposure(4_000_000, 200)
    rig.turn()
    rig.run(10.0)
    assert rig.phones[0].recordings == ["start", "stop"]
    assert rig.phones[0].exposure == (4_000_000, 200)
    assert rig.phones[0].alignments > before
