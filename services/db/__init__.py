"""Fabrics, jobs, API keys and idempotency records in PostgreSQL or, by default, an embedded SQLite file."""
