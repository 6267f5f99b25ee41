"""Sessions for jobs."""

from tests.session.conftest import session as session
