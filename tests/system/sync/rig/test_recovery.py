"""Whatever a member or a relay was told, and whenever: with an honest leader it soon knows the time."""

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import (
    run_state_machine_as_test,
)

from tests.unit.sync.rig.test_recovery import FollowerAmongLiars, RelayAmongLiars

MANY = settings(max_examples=150, stateful_step_count=30, suppress_health_check=list(HealthCheck))


@pytest.mark.parametrize("machine", [FollowerAmongLiars, RelayAmongLiars])
def test_they_recover_from_far_more(machine: type[FollowerAmongLiars]) -> None:
    run_state_machine_as_test(machine, settings=MANY)
