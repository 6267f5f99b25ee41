"""What one camera of this machine does, measured without a rig: its stamps, its starts, what moves its phase.

Imports cameras and the engine's estimators; no leader, no network.
"""
