"""Acceptance: whether a change of the code left every figure at least as good as it was."""
