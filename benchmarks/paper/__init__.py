"""The paper measured again, and more tables of our own, all simulated: `python -m benchmarks.paper`."""
