"""Other programs that follow this leader's time: the Android apps libsoftwaresync and RecSync, rpicam-apps.

Their sockets, on top of the engines in `sync/foreign`. Nothing here asks anybody who they are.
"""
