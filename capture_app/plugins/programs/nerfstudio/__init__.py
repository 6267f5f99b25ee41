"""nerfstudio: its transforms.json, read and written."""
