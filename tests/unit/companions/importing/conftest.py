"""Fixtures that these tests share with those of sessions."""

from tests.unit.session.conftest import make_images as make_images
from tests.unit.session.conftest import session as session
