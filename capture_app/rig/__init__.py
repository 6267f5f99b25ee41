"""The way to a running rig: connect to it or start it, watch it, take bursts and recordings, operate it."""
