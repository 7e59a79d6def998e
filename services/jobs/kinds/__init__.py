"""One small module a kind of job: its inputs, checked before it is queued, and ``run``, which does it."""
