"""The screen's own dark and light themes."""

from textual.theme import Theme

DARK = Theme(
    name="gcs-dark",
    dark=True,
    primary="#3d8bd9",
    secondary="#5a7fa3",
    accent="#f0b429",
    success="#57c285",
    warning="#f0b429",
    error="#e0607e",
    foreground="#e4e8ec",
    background="#101418",
    surface="#151a20",
    panel="#232c36",
)
LIGHT = Theme(
    name="gcs-light",
    dark=False,
    primary="#1769c2",
    secondary="#44617d",
    accent="#0b5cad",
    success="#17803d",
    warning="#c07a00",
    error="#d61f55",
    foreground="#14191e",
    background="#f1f4f7",
    surface="#ffffff",
    panel="#e3e9ef",
    # Paler than derived: muted and warning text on the chosen row must reach a contrast of 4.5.
    variables={"primary-muted": "#c9dcf0"},
)
"""Bright ground for sunlight on a field."""
