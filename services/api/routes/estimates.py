"""`/v1/estimates`: a fabric's mechanics from one or two depth pictures and its weight."""

from __future__ import annotations

import json
from collections import Counter
from typing import Annotated, Any

from fastapi import APIRouter, Depends, File, Form, UploadFile
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field

from capture.documents import CameraDocument, SetupDocument
from renderer.camera import CANONICAL_CAMERA
from services.api.auth import Caller, require
from services.api.context import request_id
from services.api.documented import problems
from services.api.estimate_task import estimate_pictures
from services.api.forms import known_fields_only
from services.api.idempotency import Answer, IdempotencyKey, Once, fingerprint
from services.api.inference import InferenceBusyError, InferenceTimeoutError
from services.api.model_folder import require_model
from services.api.problems import ProblemError
from services.api.scopes import ApiScope
from services.api.state import ServiceState, get_state
from services.api.uploads import PictureSize, check_png, parse_json_field
from services.jobs.task import Call
from simcore.errors import InputError
from simcore.parameters import ESTIMATED_NAMES, LIMITS, UNITS

router = APIRouter(prefix="/v1/estimates", tags=["estimates"])
MOST_REPEATS = 8
LOW_DENSITY, HIGH_DENSITY = LIMITS["density"]


class EstimateView(BaseModel):
    """What the pictures and the weight tell of a fabric."""

    parameters: dict[str, float] = Field(description="The six stiffnesses, SI.")
    units: dict[str, str] = Field(description="Unit of each parameter.")
    intervals_90: dict[str, tuple[float, float]] = Field(description="90 % interval of each parameter.")
    intervals_calibrated: bool = Field(
        description="False: the model was calibrated on too few fabrics for its intervals to promise anything."
    )
    density: float = Field(description="As given [kg/m²].")
    out_of_distribution: bool = Field(description="Unlike what the model was trained on: do not trust the intervals.")
    out_of_distribution_score: float | None = Field(
        description="1 is the border; null where the model has learnt nothing of a scene."
    )
    out_of_distribution_reasons: list[str] = Field(
        description="What of the set-up, the density or a picture is unlike anything that the model was trained on."
    )
    scenes: list[str] = Field(description="Scenes the estimate rests on.")
    notes: list[str] = Field(
        description="What speaks against the poses found in the pictures, which are named as field and number: "
        "`stretch-0`. Empty where nothing does."
    )
    model_version: str


Pictures = list[UploadFile]
NO_PICTURES: list[UploadFile] = []


@router.post(
    "",
    response_model=EstimateView,
    responses=problems(413, 415, 503),
    summary="Estimate a fabric's mechanics",
)
async def create_estimate(
    state: Annotated[ServiceState, Depends(get_state)],
    caller: Annotated[Caller, Depends(require(ApiScope.ESTIMATES_WRITE))],
    _form: Annotated[None, Depends(known_fields_only)],  # behind the caller: who may not ask is told that
    density: Annotated[
        float, Form(ge=LOW_DENSITY, le=HIGH_DENSITY, allow_inf_nan=False, description="[kg/m²]", examples=[0.2])
    ],
    hanging: Annotated[
        Pictures, File(description="16-bit depth PNG of scene `hanging`; several are repeats.")
    ] = NO_PICTURES,
    stretch: Annotated[Pictures, File(description="The same of scene `stretch`.")] = NO_PICTURES,
    camera: Annotated[
        str,
        Form(
            max_length=4000,
            description="JSON with `width`, `height`, `fx`, `fy`, `cx`, `cy`, `depth_unit_m` and optionally "
            "`distortion`, as in a capture set. May be left out only for 256 x 256 pictures of the canonical camera.",
        ),
    ] = "",
    setup: Annotated[
        str,
        Form(
            max_length=8000,
            description="JSON with `sample_size_m`, `camera_from_panel`, `panel`, `pins_m`, `pin_radius_m`, each "
            "optional, as in a capture set.",
        ),
    ] = "",
    idempotency_key: IdempotencyKey = None,
) -> JSONResponse:
    """From one or both scenes, as a form with files. Scope `estimates:write`."""
    most = state.settings.max_picture_pixels
    pictures: dict[str, bytes] = {}
    sizes: set[PictureSize] = set()
    for scene, uploads in (("hanging", hanging), ("stretch", stretch)):
        for repeat, upload in enumerate(uploads):
            name = f"{scene}-{repeat}.png"
            pictures[name] = await upload.read()
            sizes.add(check_png(pictures[name], name, most))
    document = _document(pictures, sizes, density, camera, setup)
    asked = {"document": document, "pictures": pictures}
    hours = state.settings.idempotency_hours
    once = Once(state.database, caller, idempotency_key, fingerprint("estimates", asked), hours)
    earlier = await run_in_threadpool(once.earlier)
    if earlier is not None:
        return earlier
    body = await _compute(state, json.dumps(document), pictures, density)
    return await run_in_threadpool(once.answer, lambda session: Answer(200, body))


async def _compute(state: ServiceState, document: str, pictures: dict[str, bytes], density: float) -> dict[str, Any]:
    arguments = (document, pictures, density, require_model(state.settings.model))
    call = Call(estimate_pictures, arguments, {"request_id": request_id()})
    try:
        found: dict[str, Any] = await state.inference.run(call)
    except InferenceBusyError as error:
        state.metrics.estimates_refused.inc()
        raise ProblemError(503, error.code, str(error), {"Retry-After": str(error.retry_after_s)}) from None
    except InferenceTimeoutError as error:
        raise ProblemError(503, error.code, str(error), {"Retry-After": "5"}) from None
    units = {name: UNITS[name] for name in ESTIMATED_NAMES}
    view = EstimateView.model_validate({**found, "units": units, "density": density})
    return view.model_dump(mode="json")


def _document(
    pictures: dict[str, bytes], sizes: set[PictureSize], density: float, camera: str, setup: str
) -> dict[str, Any]:
    """The upload as a capture set."""
    if not pictures:
        raise InputError("no picture: send a depth PNG as 'hanging', as 'stretch', or both", code="no_captures")
    of_scene = Counter(name.split("-")[0] for name in pictures)
    if max(of_scene.values()) > MOST_REPEATS:
        raise InputError(f"at most {MOST_REPEATS} pictures of each scene are taken", code="too_many_captures")
    given = parse_json_field(camera, "camera", CameraDocument)
    if given is None:
        if sizes != {PictureSize(CANONICAL_CAMERA.width, CANONICAL_CAMERA.height)}:
            raise InputError(
                "send 'camera' with the intrinsics (width, height, fx, fy, cx, cy, depth_unit_m): only 256 x 256 "
                "pictures of the canonical camera go without",
                code="camera_missing",
            )
        given = CameraDocument.from_camera(CANONICAL_CAMERA)
    held = parse_json_field(setup, "setup", SetupDocument)
    return {
        "format": "drape-capture-set/1",
        "camera": given.model_dump(mode="json", exclude_none=True),
        **({"setup": held.model_dump(mode="json", exclude_unset=True)} if held is not None else {}),
        "fabrics": [{"id": "fabric", "density": density}],
        "captures": [
            {"id": name.removesuffix(".png"), "fabric": "fabric", "scene": name.split("-")[0], "depth": name}
            for name in pictures
        ],
    }
