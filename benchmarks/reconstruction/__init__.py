"""Accuracy of depth and clouds against the truth and against simpler methods."""
