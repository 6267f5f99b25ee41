"""The rig's time for other sensors: marks, a Lab Streaming Layer outlet, a reference clock for chrony."""
