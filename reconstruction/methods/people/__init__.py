"""People in 3D: joints at one instant by the time of each frame, with an error for each."""
