"""Version of what the solver computes."""

SOLVER_VERSION = 7
"""Raised when its results change, be it in their last bits: what was kept or begun with another is not mixed in."""
