"""Runs pytest in the checkout, under Windows: `python unit_tests.py ARGUMENT...`."""

import os
import sys

CHECKOUT = r"Z:\checkout"

os.chdir(CHECKOUT)
sys.path.insert(0, CHECKOUT)

import pytest  # noqa: E402 - from here on, the tests are found

sys.exit(pytest.main(sys.argv[1:]))
