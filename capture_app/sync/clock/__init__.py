"""Clock filter: from time messages to a time map between two clocks."""
