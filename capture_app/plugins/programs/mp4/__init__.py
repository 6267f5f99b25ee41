"""MP4: a video of each camera, with the sound of imported recordings."""
