"""Pages: the frame around all reports, what is embedded in them, and pages to walk round in."""
