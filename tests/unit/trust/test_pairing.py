"""One-time codes: who knows them, who only guesses, and who sits in between."""

import pytest

from capture_app.common.errors import BadInputError, UnknownMachineError
from capture_app.common.pairing_codes import Role, parse_code
from capture_app.trust.spake2_exchange import GOOD_FOR_S, TRIES, Candidate, Invitations, _proof

NODE, LEADER, OTHER = "node-pin", "leader-pin", "other-pin"


class Clock:
    now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def desk(clock: Clock) -> Invitations:
    return Invitations(clock)


def another(code: str) -> str:
    return f"{(int(code) + 1) % 10**8:08d}"


def attempt(desk: Invitations, code: str, *, pin: str = NODE, seen: str = LEADER, said: str = NODE) -> None:
    """A machine of that pin tries a code at a leader that shows a pin, and hears that machine say one."""
    candidate = Candidate(code, pin, seen)
    spake2_message, begun, key = desk.answer(said, candidate.spake2_message, LEADER)
    candidate.check(desk.accept(begun, key, candidate.prove(spake2_message)))


def assert_no_code_is_good(desk: Invitations) -> None:
    with pytest.raises(UnknownMachineError, match="no pairing code"):
        desk.answer(NODE, b"", LEADER)


def test_the_code_makes_both_known_to_each_other_once(desk: Invitations) -> None:
    invitation = desk.invite(Role.CAMERA)
    attempt(desk, invitation.code)
    with pytest.raises(UnknownMachineError, match="no pairing code"):
        attempt(desk, invitation.code)


def test_a_code_is_good_for_a_few_tries(desk: Invitations) -> None:
    code = desk.invite(Role.CAMERA).code
    for _ in range(TRIES):
        with pytest.raises(UnknownMachineError, match="wrong pairing code"):
            attempt(desk, another(code))
    with pytest.raises(UnknownMachineError, match="no pairing code"):
        attempt(desk, code)


def test_who_leaves_before_proving_anything_has_spent_a_try(desk: Invitations) -> None:
    code = desk.invite(Role.CAMERA).code
    for _ in range(TRIES):
        desk.answer(NODE, Candidate(another(code), NODE, LEADER).spake2_message, LEADER)
    assert_no_code_is_good(desk)


def test_a_code_ends_after_some_minutes_also_while_it_is_tried(desk: Invitations, clock: Clock) -> None:
    code = desk.invite(Role.CAMERA).code
    candidate = Candidate(code, NODE, LEADER)
    spake2_message, begun, key = desk.answer(NODE, candidate.spake2_message, LEADER)
    clock.now_s += GOOD_FOR_S
    with pytest.raises(UnknownMachineError):
        desk.accept(begun, key, candidate.prove(spake2_message))
    with pytest.raises(UnknownMachineError, match="no pairing code"):
        attempt(desk, code)


@pytest.mark.parametrize("changed", [{"seen": OTHER}, {"said": OTHER}, {"pin": OTHER}])
def test_who_shows_another_certificate_to_one_of_them_is_found_out(
    desk: Invitations, changed: dict[str, str]
) -> None:
    """Somebody in between passes on all words, and shows a certificate of its own to one end or to both."""
    code = desk.invite(Role.CAMERA).code
    with pytest.raises(UnknownMachineError):
        attempt(desk, code, **changed)


def test_a_false_leader_cannot_prove_itself(desk: Invitations) -> None:
    candidate = Candidate("12345678", NODE, LEADER)
    false = Invitations(lambda: 0.0)
    false.invite(Role.CAMERA)
    spake2_message, _, _ = false.answer(NODE, candidate.spake2_message, LEADER)
    proof = candidate.prove(spake2_message)
    for claimed in (b"", proof, bytes(32)):
        with pytest.raises(UnknownMachineError, match="does not know the code"):
            candidate.check(claimed)


@pytest.mark.parametrize(
    "spake2_message", [b"", b"A", b"A" + bytes(32), b"A" + b"\xff" * 32, b"B" + bytes(32), b"\0" * 99]
)
def test_invalid_spake2_message_is_refused(desk: Invitations, spake2_message: bytes) -> None:
    desk.invite(Role.CAMERA)
    with pytest.raises(BadInputError):
        desk.answer(NODE, spake2_message, LEADER)
    with pytest.raises(BadInputError):
        Candidate("12345678", NODE, LEADER).prove(spake2_message)


def test_a_word_that_is_sent_back_is_refused(desk: Invitations) -> None:
    candidate = Candidate("12345678", NODE, LEADER)
    with pytest.raises(BadInputError):
        candidate.prove(candidate.spake2_message)
    with pytest.raises(BadInputError):
        candidate.prove(b"B" + candidate.spake2_message[1:])


def test_of_two_machines_that_begin_with_one_code_the_first_is_let_in(desk: Invitations) -> None:
    code = desk.invite(Role.CAMERA).code
    candidates = [Candidate(code, pin, LEADER) for pin in (NODE, OTHER)]
    begun = [
        desk.answer(pin, of.spake2_message, LEADER) for pin, of in zip((NODE, OTHER), candidates, strict=True)
    ]
    proofs = [of.prove(message) for of, (message, *_) in zip(candidates, begun, strict=True)]
    candidates[0].check(desk.accept(begun[0][1], begun[0][2], proofs[0]))
    with pytest.raises(UnknownMachineError, match="wrong pairing code"):
        desk.accept(begun[1][1], begun[1][2], proofs[1])


def test_a_leader_proves_nothing_before_the_exchange() -> None:
    """Anyone can make the proof of an empty key."""
    with pytest.raises(UnknownMachineError, match="does not know the code"):
        Candidate("12345678", NODE, LEADER).check(_proof(b"", b"leader"))


def test_codes_have_eight_digits_and_differ(desk: Invitations) -> None:
    codes = {desk.invite(Role.CAMERA).code for _ in range(50)}
    assert len(codes) > 45
    assert all(parse_code(code) == code for code in codes)


def test_codes_that_are_good_side_by_side_are_told_apart_by_their_first_digit(desk: Invitations) -> None:
    codes = [desk.invite(Role.CAMERA).code for _ in range(10)]
    assert len({code[0] for code in codes}) == 10
    for code in codes[5:] + codes[:5]:
        candidate = Candidate(code, NODE, LEADER)
        spake2_message, begun, key = desk.answer(NODE, candidate.spake2_message, LEADER, code[0])
        candidate.check(desk.accept(begun, key, candidate.prove(spake2_message)))
    assert_no_code_is_good(desk)


def test_of_more_than_ten_codes_the_oldest_is_good_no_more(desk: Invitations) -> None:
    codes = [desk.invite(Role.CAMERA).code for _ in range(11)]
    assert codes[0][0] == codes[10][0]
    candidate = Candidate(codes[0], NODE, LEADER)
    spake2_message, begun, key = desk.answer(NODE, candidate.spake2_message, LEADER, codes[0][0])
    with pytest.raises(UnknownMachineError, match="wrong pairing code"):
        desk.accept(begun, key, candidate.prove(spake2_message))
