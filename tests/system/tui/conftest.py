"""Fixtures that these tests share with those of other folders."""

from tests.unit.tui.conftest import _strips_share_a_cache as _strips_share_a_cache
from tests.unit.tui.conftest import _style_sheets_are_parsed_once as _style_sheets_are_parsed_once
from tests.unit.tui.conftest import _toasts_stay as _toasts_stay
from tests.unit.tui.conftest import snap_compare as snap_compare
from tests.unit.tui.conftest import utc as utc
