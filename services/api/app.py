"""The application."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import APIRouter, FastAPI
from starlette.routing import Route

from services.api.body_limit import PLAIN_BODY_BYTES, BodyLimit
from services.api.head import HeadAsGet
from services.api.housekeeping import keep_house
from services.api.inference import Inference
from services.api.key_first import KeyFirst
from services.api.metrics import Metrics
from services.api.middleware import RequestRecord
from services.api.openapi import install_openapi
from services.api.problems import install_problem_handlers
from services.api.routes import (
    datasets,
    diagnoses,
    drape_distances,
    estimates,
    fabric_search,
    fabrics,
    health,
    jobs,
)
from services.api.state import ServiceState
from services.db.engine import Database
from services.settings import Settings
from services.version import software_version

ROUTERS: tuple[APIRouter, ...] = (
    estimates.router,
    drape_distances.router,
    fabric_search.router,
    fabrics.router,
    diagnoses.router,
    datasets.router,
    jobs.router,
    health.router,
)


def create_app(settings: Settings) -> FastAPI:
    """An application with its own database connections and inference process, ended with it."""
    database = Database(settings.database)
    metrics = Metrics(database)
    inference = Inference(
        queue=settings.estimate_queue,
        timeout_s=settings.estimate_timeout_s,
        observe=metrics.estimate_seconds.observe,
        log_level=settings.log_level,
    )
    state = ServiceState(settings, database, inference, metrics)

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        housekeeping = asyncio.create_task(keep_house(state))
        yield
        housekeeping.cancel()
        state.close()

    app = FastAPI(
        title="Drapemeter",
        version=software_version(),
        lifespan=lifespan,
        docs_url=None,  # the interactive pages load scripts from elsewhere
        redoc_url=None,
        redirect_slashes=False,
    )
    app.state.service = state
    for router in ROUTERS:
        app.include_router(router)
    # the application's own list has one entry for a whole router
    routes = (*app.routes, *(route for router in ROUTERS for route in router.routes))
    app.state.api_routes = [route for route in routes if isinstance(route, Route)]
    install_problem_handlers(app)
    install_openapi(app)
    app.add_middleware(KeyFirst, state=state)
    app.add_middleware(BodyLimit, limit=settings.max_request_bytes, plain_limit=PLAIN_BODY_BYTES)
    app.add_middleware(HeadAsGet)
    app.add_middleware(RequestRecord, metrics=metrics)
    return app
