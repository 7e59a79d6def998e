"""Versions of what the solvers compute and of the fabrics that are drawn."""

SOLVER_VERSION = 10
"""Raised when its results change, be it in their last bits: what was kept or begun with another is not mixed in."""
BATCH_VERSION = 1
"""Raised when the batch solver's results change and those of single drapes do not."""
PRIOR_VERSION = 1
"""Raised when the same seed draws other fabrics."""
