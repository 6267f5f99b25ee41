"""Which devices are admitted to a page, and which are not."""

import secrets

import pytest

from capture_app.common.errors import UnknownMachineError
from capture_app.web.admission import GOOD_FOR_S, TICKET_S, Admission


class HandClock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def key() -> str:
    return secrets.token_hex(16)


def test_a_secret_lets_one_phone_in_and_the_next_one_is_another() -> None:
    admission = Admission(HandClock())
    first, ours = admission.secret, key()
    assert admission.admit(first, ours, "left").name == "left"
    assert admission.secret != first
    with pytest.raises(UnknownMachineError, match="Another phone has used"):
        admission.admit(first, key(), "thief")


def test_a_phone_comes_back_under_its_name_without_a_secret() -> None:
    admission, ours = Admission(HandClock()), key()
    came = admission.admit(admission.secret, ours, "left")
    assert admission.admit("", ours, "other") == came


def test_a_phone_that_was_put_off_stays_off_until_it_scans_another_code() -> None:
    admission, ours = Admission(HandClock()), key()
    secret = admission.secret
    admission.put_off(admission.admit(secret, ours, "left"))
    for again in ("", secret):
        with pytest.raises(UnknownMachineError, match="has removed this phone"):
            admission.admit(again, ours, "left")
    assert admission.admit(admission.secret, ours, "left").name == "left"
    assert admission.admit("", ours, "left").name == "left"


def test_a_phone_whose_answer_was_lost_may_ask_again_by_the_same_secret() -> None:
    admission, ours = Admission(HandClock()), key()
    secret = admission.secret
    assert admission.admit(secret, ours, "left") == admission.admit(secret, ours, "left")


def test_a_secret_is_good_for_ten_minutes() -> None:
    clock = HandClock()
    admission = Admission(clock)
    secret = admission.secret
    assert admission.good_for_s == GOOD_FOR_S
    clock.now_s += GOOD_FOR_S
    with pytest.raises(UnknownMachineError, match="mistyped or has expired"):
        admission.admit(secret, key(), "late")
    assert admission.admit(admission.secret, key(), "in time").name == "in-time"


@pytest.mark.parametrize("secret", ["", "guess", "a" * 22])
def test_nobody_is_let_in_without_the_secret(secret: str) -> None:
    admission = Admission(HandClock())
    with pytest.raises(UnknownMachineError):
        admission.admit(secret, key(), "")


@pytest.mark.parametrize("bad", ["", "0" * 31, "x" * 32, "0" * 33])
def test_a_phone_needs_a_key_of_its_own(bad: str) -> None:
    admission = Admission(HandClock())
    secret = admission.secret
    with pytest.raises(UnknownMachineError):
        admission.admit(secret, bad, "")
    assert admission.secret == secret


def test_phones_that_want_one_name_get_names_of_their_own() -> None:
    admission = Admission(HandClock())
    assert [admission.admit(admission.secret, key(), "Pixel 7").name for _ in range(3)] == [
        "Pixel-7",
        "Pixel-7-2",
        "Pixel-7-3",
    ]
    assert admission.admit(admission.secret, key(), "../…").name == "phone"


def test_a_ticket_opens_one_link_and_soon() -> None:
    clock = HandClock()
    admission = Admission(clock)
    admitted = admission.admit(admission.secret, key(), "left")
    ticket = admission.ticket(admitted)
    assert admission.redeem(ticket) == admitted
    assert admission.redeem(ticket) is None
    late = admission.ticket(admitted)
    clock.now_s += TICKET_S
    assert admission.redeem(late) is None
    assert admission.redeem("guess") is None
