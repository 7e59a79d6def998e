"""`/v1/diagnoses`: where simulation and captures part, and why."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Depends, File, Form, UploadFile
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import JSONResponse

from capture.capture_set import CaptureSet
from capture.documents import CaptureSetDocument, parse_document
from capture.picture import check_size
from diagnosis.tasks.put_up import check_set_ups
from services.api.auth import Caller, require
from services.api.documented import accepted, problems
from services.api.forms import known_fields_only
from services.api.idempotency import IdempotencyKey
from services.api.scopes import ApiScope
from services.api.state import ServiceState, get_state
from services.api.submit import submit_job
from services.api.uploads import HEADER_BYTES, check_png
from services.api.views import JobView
from services.jobs.archive import CAPTURES_FILE, ArchiveLimits, beginnings, names_in, read_captures_json
from services.jobs.files import FileContent
from services.jobs.kinds.diagnosis import ARCHIVE_NAME, DiagnosisInputs, picture_name, picture_names
from services.names import split_names
from services.settings import Settings
from simcore.errors import InputError

LARGEST_PICTURES = 16
"""A capture set may have as many pixels as so many of the largest pictures: all are held at once."""

router = APIRouter(prefix="/v1/diagnoses", tags=["diagnoses"])


@router.post(
    "",
    status_code=202,
    response_model=JobView,
    responses={**accepted("Queued"), **problems(413, 415, 429, 503)},
    summary="Diagnose a capture set",
)
async def create_diagnosis(
    state: Annotated[ServiceState, Depends(get_state)],
    caller: Annotated[Caller, Depends(require(ApiScope.DIAGNOSES_WRITE))],
    _form: Annotated[None, Depends(known_fields_only)],  # behind the caller: who may not ask is told that
    capture_set: Annotated[UploadFile, File(description="ZIP of `captures.json` and its PNG files.")],
    effects: Annotated[str, Form(max_length=2000, description="Try only these, comma-separated.")] = "",
    without: Annotated[str, Form(max_length=2000, description="Leave these effects out, comma-separated.")] = "",
    resolution_m: Annotated[float, Form(ge=0.002, le=0.05, allow_inf_nan=False, description="Mesh cell [m].")] = 0.01,
    lpips: Annotated[bool, Form(description="Tell the shrinkage in LPIPS, too; some more simulations.")] = False,
    idempotency_key: IdempotencyKey = None,
) -> JSONResponse:
    """Simulates for minutes: poll the job. Its `result` is the gap report, `report.html` is among its files.

    Scope `diagnoses:write`.
    """
    tried = split_names(effects)
    if effects and not tried:
        raise InputError(f"effects {effects!r} name none: give names, or leave it away", code="no_effects")
    inputs = DiagnosisInputs(
        effects=tried,
        without=split_names(without),
        resolution_m=resolution_m,
        lpips=lpips,
        most_bytes=state.settings.max_unpacked_bytes,
    )
    await run_in_threadpool(inputs.options)
    content = await capture_set.read()
    await run_in_threadpool(_check, content, state.settings, resolution_m)
    file = FileContent(ARCHIVE_NAME, "application/zip", content)
    return await run_in_threadpool(
        submit_job,
        state,
        caller,
        idempotency_key,
        "diagnosis",
        inputs,
        files=(file,),
        own=("most_bytes",),
    )


def _check(content: bytes, settings: Settings, resolution_m: float) -> CaptureSetDocument:
    """Everything that can be known without decoding a picture."""
    limits = ArchiveLimits(settings.max_unpacked_bytes)
    document = parse_document(read_captures_json(content, limits), CAPTURES_FILE)
    names = names_in(content, limits)
    pictures = picture_names(document)
    missing = [depth for name, depth in pictures.items() if name not in names]
    if missing:
        raise InputError(f"the archive lacks {missing[0]}, which {CAPTURES_FILE} names", code="depth_missing")
    heads = beginnings(content, limits, pictures, HEADER_BYTES)
    sizes = {name: check_png(head, name, settings.max_picture_pixels) for name, head in heads.items()}
    captures = CaptureSet(Path(), document).captures
    pixels = sum(sizes[picture_name(c.document)].width * sizes[picture_name(c.document)].height for c in captures)
    if pixels > (most := LARGEST_PICTURES * settings.max_picture_pixels):
        raise InputError(
            f"the captures have {pixels:.3g} pixels in all, more than {most:.3g}: send fewer, or smaller pictures",
            code="archive_too_large",
        )
    for capture in captures:
        size = sizes[picture_name(capture.document)]
        check_size(capture.document.depth, size.width, size.height, capture.camera)
    check_set_ups(CaptureSet(Path(), document), resolution_m)
    return document
