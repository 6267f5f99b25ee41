"""Pictures in a terminal: drawn in cells, with aids for focus and exposure; live previews of all cameras.

Everything else of the screen may use it; it knows no rig and no session.
"""
