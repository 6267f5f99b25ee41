"""What every command shares: geometry, output, stages, drawing, and where native libraries load.

The ground of `reconstruction`: imports no other wing.
"""
