"""What Prometheus reads at ``/metrics``."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import GaugeMetricFamily
from sqlalchemy import func, select

from services.db.engine import Database
from services.db.jobs import Job, JobStatus


class JobCounts:
    """Jobs by status, asked of the database when Prometheus asks."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def describe(self) -> list[GaugeMetricFamily]:
        """Named without asking the database."""
        return [GaugeMetricFamily("drapemeter_jobs", "Jobs by kind and status", labels=["kind", "status"])]

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """One family."""
        (family,) = self.describe()
        with self._database.read() as session:
            rows = session.execute(select(Job.kind, Job.status, func.count()).group_by(Job.kind, Job.status))
            for kind, status, count in rows:
                family.add_metric([kind, JobStatus(status).value], count)
        yield family


class Metrics:
    """The server's counters; a registry of its own, so that several applications live in one process."""

    def __init__(self, database: Database) -> None:
        self.registry = CollectorRegistry()
        self.registry.register(JobCounts(database))
        labels = ["method", "route", "status"]
        self._requests = Counter("drapemeter_requests", "Requests answered", labels, registry=self.registry)
        self._seconds = Histogram(
            "drapemeter_request_seconds", "Time to answer", ["method", "route"], registry=self.registry
        )
        self.estimates_refused = Counter(
            "drapemeter_estimates_refused", "Estimates refused because too many waited", registry=self.registry
        )
        self.estimate_seconds = Histogram(
            "drapemeter_estimate_seconds", "Time of an estimate in the inference process", registry=self.registry
        )

    def observe_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count an answered request; ``route`` is its template, never the caller's path."""
        known = method if method in {"GET", "POST", "PUT", "DELETE", "HEAD", "OPTIONS", "PATCH"} else "other"
        self._requests.labels(known, route, str(status)).inc()
        self._seconds.labels(known, route).observe(seconds)
