"""Measures of a result, with their uncertainty."""
