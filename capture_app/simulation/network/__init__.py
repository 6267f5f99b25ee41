"""Links, radio cells and wandering clocks in virtual time; imports no other wing of `simulation`."""
