"""`/v1/estimates`: a fabric's mechanics from one or two depth pictures and its weight."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Depends, File, Form, UploadFile
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field

from capture.capture_set import CAPTURES_FILE, CaptureSet
from capture.documents import CameraDocument, SensorDocument, SetupDocument, parse_document
from capture.picture import check_size
from diagnosis.effects_in_poses import check_effects
from diagnosis.extension import SimulatorExtension
from renderer.camera import CANONICAL_CAMERA
from services.api.auth import Caller, require
from services.api.context import request_id
from services.api.documented import accepted, problems
from services.api.estimate_task import estimate_pictures
from services.api.forms import known_fields_only
from services.api.idempotency import Answer, IdempotencyKey, Once, fingerprint
from services.api.inference import InferenceBusyError, InferenceTimeoutError
from services.api.problems import ProblemError
from services.api.scopes import ApiScope
from services.api.state import ServiceState, get_state
from services.api.submit import submit_job
from services.api.uploads import PictureSize, check_png, parse_json_field
from services.api.views import JobView
from services.jobs.files import FileContent
from services.jobs.kinds.estimate import EstimateInputs
from services.jobs.task import Call
from services.model_folder import require_model
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
    responses={202: {**accepted("Queued, with `simulator`")[202], "model": JobView}, **problems(413, 415, 429, 503)},
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
    simulator: Annotated[
        str,
        Form(
            max_length=16_000,
            description="JSON of a `simulator.json` of `drapemeter diagnose --apply`: the pictures show the effects in "
            "it. The estimate then takes two dozen simulations and is a job.",
        ),
    ] = "",
    sensor: Annotated[
        str,
        Form(
            max_length=4000,
            description="JSON with `range_noise_m`, `at_m`, `quantisation_m`, each optional, as in a capture set. "
            "Simulated pictures get that noise; without `simulator` it changes nothing.",
        ),
    ] = "",
    idempotency_key: IdempotencyKey = None,
) -> JSONResponse:
    """From one or both scenes, as a form with files.

    With `simulator` the answer is 202: poll the job, whose `result` holds the same, `simulator` as given, and
    `simulated`: the parameters `without_effects`, how many `simulations` were asked for, how many of them came
    `not_at_rest`, and what is `left` between what the network says of the pictures and of the last of these (root mean
    square in ln p). Scope `estimates:write`.
    """
    sent = {"hanging": hanging, "stretch": stretch}
    pictures = {f"{scene}-{n}.png": await one.read() for scene, files in sent.items() for n, one in enumerate(files)}
    sizes = {name: check_png(content, name, state.settings.max_picture_pixels) for name, content in pictures.items()}
    document = _document(sizes, density, camera, setup, sensor)
    extension = parse_json_field(simulator, "simulator", SimulatorExtension)
    if extension is not None:
        return await run_in_threadpool(_queue, state, caller, idempotency_key, document, pictures, extension)
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


def _queue(
    state: ServiceState,
    caller: Caller,
    key: str | None,
    document: dict[str, Any],
    pictures: dict[str, bytes],
    extension: SimulatorExtension,
) -> JSONResponse:
    """As a job, where the pictures show effects; checked as far as can be without decoding a picture."""
    require_model(state.settings.model)
    check_effects(CaptureSet(Path(), parse_document(json.dumps(document), CAPTURES_FILE)), extension)
    files = [FileContent(name, "image/png", content) for name, content in pictures.items()]
    inputs = EstimateInputs(document=document, simulator=extension)
    return submit_job(state, caller, key, "estimate", inputs, files=files)


def _document(sizes: dict[str, PictureSize], density: float, camera: str, setup: str, sensor: str) -> dict[str, Any]:
    """The upload as a capture set; sizes are of pictures by the file names that they get in it."""
    if not sizes:
        raise InputError("no picture: send a depth PNG as 'hanging', as 'stretch', or both", code="no_captures")
    of_scene = Counter(name.split("-")[0] for name in sizes)
    if max(of_scene.values()) > MOST_REPEATS:
        raise InputError(f"at most {MOST_REPEATS} pictures of each scene are taken", code="too_many_captures")
    given = parse_json_field(camera, "camera", CameraDocument)
    if given is None:
        if set(sizes.values()) != {PictureSize(CANONICAL_CAMERA.width, CANONICAL_CAMERA.height)}:
            raise InputError(
                "send 'camera' with the intrinsics (width, height, fx, fy, cx, cy, depth_unit_m): only 256 x 256 "
                "pictures of the canonical camera go without",
                code="camera_missing",
            )
        given = CameraDocument.from_camera(CANONICAL_CAMERA)
    seen = given.as_camera()
    for name, size in sizes.items():
        check_size(name, size.width, size.height, seen)
    held = parse_json_field(setup, "setup", SetupDocument)
    known = parse_json_field(sensor, "sensor", SensorDocument)
    return {
        "format": "drape-capture-set/1",
        "camera": given.model_dump(mode="json", exclude_none=True),
        **({"setup": held.model_dump(mode="json", exclude_unset=True)} if held is not None else {}),
        **({"sensor": known.model_dump(mode="json", exclude_unset=True)} if known is not None else {}),
        "fabrics": [{"id": "fabric", "density": density}],
        "captures": [
            {"id": name.removesuffix(".png"), "fabric": "fabric", "scene": name.split("-")[0], "depth": name}
            for name in sizes
        ],
    }
