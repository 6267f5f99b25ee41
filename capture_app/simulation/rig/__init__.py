"""Whole rigs in virtual time: the engine's own leaders, clients, relays on simulated devices and links.

Imports `devices` and `network`; draws no pictures.
"""
