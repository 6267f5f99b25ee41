"""Triggers without synchronization, beside the whole chain."""
