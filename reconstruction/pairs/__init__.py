"""What two cameras have in common: points that both see, their homography, and what the pair is good for.

Imports `common` only.
"""
