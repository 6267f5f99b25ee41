"""USB webcams and other Video4Linux2 cameras."""
