"""Open, verify and summarize a session without changing it."""
