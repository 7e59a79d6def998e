"""Fragments of the OpenAPI document: which problems a route answers with."""

from __future__ import annotations

from typing import Any

from services.api.problems import MEDIA_TYPE

MEANINGS: dict[int, str] = {
    400: "Malformed request",
    401: "No valid API key",
    403: "The API key lacks a scope",
    404: "No such thing",
    409: "In conflict with what is there",
    412: "Changed meanwhile",
    413: "Request too large",
    415: "Neither JSON nor a form, whichever is wanted",
    422: "Bad input; `code` says which",
    429: "Too many jobs are waiting",
    503: "Not now; `Retry-After` says when",
}
ETAG = {"ETag": {"description": "The version, for `If-Match` and `If-None-Match`", "schema": {"type": "string"}}}
Responses = dict[int | str, dict[str, Any]]


def problems(*statuses: int) -> Responses:
    """Problem answers of a route; those of the key and of bad input come by themselves."""
    content = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {s: {"description": MEANINGS[s], "content": content} for s in sorted({400, 401, 403, 422, *statuses})}


def accepted(description: str) -> Responses:
    """202 with the headers that tell where to look and when."""
    headers = {
        "Location": {"description": "The job", "schema": {"type": "string"}},
        "Retry-After": {"description": "Seconds until asking is worth while", "schema": {"type": "integer"}},
    }
    return {202: {"description": description, "headers": headers}}
