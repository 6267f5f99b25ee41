"""Tests of both packages, by when they run: unit, system, nightly."""
