"""The estimators on a real link, between two processes."""
