"""Array types for signatures; docstrings give shapes and units."""

from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]
"""Floats (float64 throughout)."""
Mask = NDArray[Any]
"""Booleans."""
