"""Clock filter, which estimates a time map between two clocks from time messages."""
