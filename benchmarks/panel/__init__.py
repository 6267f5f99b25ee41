"""Accuracy of times read from photographs of panels."""
