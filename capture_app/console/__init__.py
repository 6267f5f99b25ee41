"""Reading and writing on a terminal: output, progress, errors and help of commands."""
