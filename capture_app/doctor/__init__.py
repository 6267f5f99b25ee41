"""Looks a machine over: what would keep it from leading a rig or joining one, each with what repairs it.

It asks and measures, and changes nothing.
"""
