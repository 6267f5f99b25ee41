"""Fixtures that these tests share with those of other folders."""

from tests.unit.session.conftest import make_images as make_images
from tests.unit.session.conftest import session as session
from tests.unit.session.conftest import small_disk as small_disk
