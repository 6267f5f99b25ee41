"""The terminal UI: displays a rig's status and sends the user's orders."""
