"""A panel that shows the time to cameras: what is lit when, where it is, and its time read off pictures.

One description (`Panel`) serves whoever draws the panel and whoever reads it. Imports `session` and what lies
below it.
"""
