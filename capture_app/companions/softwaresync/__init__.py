"""Phones with libsoftwaresync, the paper's Android app of 2019: clients of a rig by the app's protocol."""
