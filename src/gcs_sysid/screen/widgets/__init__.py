"""The panels of the live screen, one a module."""
