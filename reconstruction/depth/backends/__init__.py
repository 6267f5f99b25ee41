"""What the CPU and a GPU do differently: the costs of many depths, and the cheapest of them by smoothness.

All else of the sweep is one text for both. Imports nothing of `depth` but its pictures.
"""
