"""Write a session image by image, complete it, and recover it after a crash."""
