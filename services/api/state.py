"""What the routes of one application share."""

from __future__ import annotations

from dataclasses import dataclass

from fastapi import Request

from services.api.inference import Inference
from services.api.metrics import Metrics
from services.db.engine import Database
from services.settings import Settings


@dataclass(frozen=True)
class ServiceState:
    """Settings, database, inference process and counters."""

    settings: Settings
    database: Database
    inference: Inference
    metrics: Metrics

    def close(self) -> None:
        """End the inference process and the database's connections; closing twice does no harm."""
        self.inference.close()
        self.database.close()


def get_state(request: Request) -> ServiceState:
    """The application's state, as a dependency."""
    state: ServiceState = request.app.state.service
    return state
