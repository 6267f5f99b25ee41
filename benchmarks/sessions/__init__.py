"""What a burst costs on its way to the disk."""
