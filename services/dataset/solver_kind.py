"""Which solver a sweep uses."""

from enum import StrEnum


class SolverKind(StrEnum):
    """Their drapes are equally at rest, but not bit for bit the same."""

    SINGLE = "single"
    """One simulation after the other on one core."""
    BATCH = "batch"
    """A shard's simulations at once, on one core."""
    CUDA = "cuda"
    """A shard's simulations at once, on a GPU."""
