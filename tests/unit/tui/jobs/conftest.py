"""Sessions for jobs."""

from tests.unit.session.conftest import session as session
