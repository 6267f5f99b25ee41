"""Mode Rig: every camera's clock and phase, the rig's readiness, and its log."""
