"""MP4: a video of each camera, with sound."""
