"""Access to a running rig: start it or connect to it, watch it, take bursts and recordings, operate it."""
