"""A camera's sensor in virtual time, and its models by name; imports no other wing of `simulation`."""
