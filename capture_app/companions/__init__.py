"""Other devices and programs beside a rig: import, export, phones, monitor, panels, foreign protocols."""
