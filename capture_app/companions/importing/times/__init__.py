"""Times of a recording: the table of rules that makes them, and the tables that state them."""
