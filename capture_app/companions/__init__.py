"""Other devices and programs beside a rig: phones, monitor, panels, foreign protocols."""
