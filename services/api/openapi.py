"""The OpenAPI document, with problems in the place of FastAPI's own error form."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from services.api.problems import Problem

DESCRIPTION = """How will a fabric drape? Estimates of its mechanics from depth pictures, drape distances as people see
them, a searchable fabric library, and diagnoses of the gap between simulation and reality.

Long work answers `202` with `Location` and `Retry-After`: poll the job. Errors are RFC 9457 problems; look at `code`.
"""


def install_openapi(app: FastAPI) -> None:
    """Serve the document at ``/openapi.json``."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _make(app)
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]  # FastAPI's documented way to extend its document


def _make(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(
        title=app.title, version=app.version, description=DESCRIPTION, routes=app.routes, tags=app.openapi_tags
    )
    schemas: dict[str, Any] = document.setdefault("components", {}).setdefault("schemas", {})
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    problem = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas.update(problem.pop("$defs", {}))
    schemas["Problem"] = problem
    return document
