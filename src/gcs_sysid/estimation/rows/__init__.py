"""Regression rows: rotor signals through the actuators, windows, and their sums."""
