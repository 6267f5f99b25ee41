"""What was taken, on the screen: the contact sheet of a take, one picture of it, blinking, and the wiggle.

Reads sessions on disk; knows no rig. Shooting and the library both show takes with it.
"""
