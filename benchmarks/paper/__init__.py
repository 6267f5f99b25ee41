"""The paper's measurements repeated, and more tables of ours, all simulated: `python -m benchmarks.paper`."""
