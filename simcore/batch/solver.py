"""Many drapes at once, on a GPU or on the CPU."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import torch

from simcore.batch.alone import PROCESSES, Alone
from simcore.batch.device import Device
from simcore.batch.level import BatchLevel
from simcore.batch.newton import BatchNewton, BatchRest
from simcore.batch.placement import BatchPins, put_up
from simcore.batch.request import Request
from simcore.checks import check_request, seed_sequence
from simcore.cloths import Cloths
from simcore.contact import REACH_M, PanelContact
from simcore.cores import usable_cores
from simcore.crossings import count_crossings
from simcore.drape import Drape, DrapeStatus
from simcore.errors import InputError
from simcore.loads import Load
from simcore.mesh import GridMesh
from simcore.newton import NewtonOptions, Rest
from simcore.placement import STEPS, Perturbation, Pins
from simcore.scenes import GRAVITY_M_S2
from simcore.solver import cascade, prolong, softened
from simcore.verdict import verdict

Tensor = torch.Tensor


ROUNDS = 8
"""So many times the samples that are worked on at once are prepared together."""


class BatchSolver:
    """Brings many samples of one mesh to rest together.

    The same cascade, kernels and certificate as :class:`~simcore.solver.Solver`; linear systems by batched block
    Cholesky. Samples that do not come to rest here, or that pass through themselves, are put up again by ``Solver``,
    which knows contact of the cloth with itself; those with friction are put up by it alone, since their normal forces
    take rounds of their own. One a process, not thread-safe.

    Args:
        mesh: of every sample.
        arch: ``cuda`` or ``cpu``.
        most: largest number of samples at once; see :func:`memory_bytes` for what each takes.

    Attributes:
        put_up_again: samples that were left to ``Solver`` so far, but for those with friction.
        put_up_again_s: wall-clock time that ``Solver`` took so far [s].

    Raises:
        InputError: ``most`` is not positive.
        MissingResourceError: there is no CUDA device.
    """

    def __init__(self, mesh: GridMesh, arch: str = "cuda", most: int = 256) -> None:
        if most < 1:
            raise InputError(f"a batch holds at least one sample, not {most}", code="batch_size")
        self.device = Device(arch)
        self.mesh = mesh
        self.most = most
        self.levels = [BatchLevel(grid, self.device, max(2, most)) for grid in cascade(mesh)]
        self._alone = Alone(mesh, min(PROCESSES, usable_cores()) if arch == "cuda" else 0)
        self.put_up_again = 0
        self.put_up_again_s = 0.0

    def solve(self, requests: Sequence[Request], *, time_limit_s: float | None = None) -> list[Drape]:
        """Bring all to rest.

        Args:
            requests: any number; ``most`` are worked on at a time, and others take the places of those at rest.
            time_limit_s: CPU seconds for each of those that are put up again; the others end together.

        Returns:
            A drape for each, in their order. ``seconds`` is its share of the CPU time of its batch and, where it was
            put up again, the time that took.
        """
        for request in requests:
            check_request(self.mesh, request.setup, None, time_limit_s)
        rubbing = [n for n, r in enumerate(requests) if r.mechanics.friction > 0.0 and r.setup.panel]
        together = sorted(set(range(len(requests))) - set(rubbing))
        drapes: dict[int, Drape] = {}
        for first in range(0, len(together), ROUNDS * self.most):
            numbers = together[first : first + ROUNDS * self.most]
            drapes |= zip(numbers, self._batch([requests[n] for n in numbers]), strict=True)
        failed = [n for n, drape in drapes.items() if drape.status in (DrapeStatus.NOT_STILL, DrapeStatus.DIVERGED)]
        self.put_up_again += len(failed)
        alone = sorted(failed + rubbing)
        began = time.perf_counter()
        single = self._alone.solve([requests[n] for n in alone], time_limit_s)
        self.put_up_again_s += time.perf_counter() - began
        for n, drape in zip(alone, single, strict=True):
            if n in drapes:
                seconds, steps = drape.seconds + drapes[n].seconds, drape.iterations + drapes[n].iterations
                drape = replace(drape, seconds=seconds, iterations=steps)
            drapes[n] = drape
        return [drapes[n] for n in range(len(requests))]

    def _batch(self, requests: Sequence[Request]) -> list[Drape]:
        """As far as it is brought here."""
        began = time.process_time()
        # libraries have another way with a single matrix, whose last bits differ from those it has in a batch
        single = len(requests) == 1
        with torch.no_grad(), self.device.one_thread():
            rest, energy, steps = self._cascade([*requests, *requests] if single else requests)
        seconds = (time.process_time() - began) / len(requests)
        drapes = []
        for n, (own, crossings) in enumerate(self._crossings(rest, len(requests))):
            cloth = self.levels[-1].cloths.only(n).on(self.device.get)
            status, reason = verdict(self.mesh, cloth, own, crossings, late=False)
            drapes.append(
                Drape(
                    self.mesh, own.x.reshape(-1, 3), status, own.residual, float(energy[n]), own.stable, int(steps[n]),
                    seconds, reason,
                )
            )  # fmt: skip
        return drapes

    def _crossings(self, rest: BatchRest, count: int) -> list[tuple[Rest, int]]:
        """The first ``count`` of a batch one by one, and how often each passes through itself when it is at rest."""
        places, numbers = (
            self.device.get(rest.x),
            [self.device.get(v).tolist() for v in (rest.residual, rest.stable, rest.iterations, rest.converged)],
        )
        own = [Rest(x, *of_one) for x, of_one in zip(places[:count], zip(*numbers, strict=True), strict=False)]

        def crossings(one: Rest) -> int:
            return count_crossings(one.x.reshape(-1, 3), self.mesh.triangles) if one.converged else 0

        # a GPU is fast enough to wait for them
        with ThreadPoolExecutor(4 if self.device.arch == "cuda" else 1) as pool:
            return list(zip(own, pool.map(crossings, own), strict=True))

    def _cascade(self, requests: Sequence[Request]) -> tuple[BatchRest, Tensor, Tensor]:
        """Rest on the last level, energies [J] and steps taken on all, those of putting up included."""
        randoms = [Perturbation.draw(r.setup, r.jitter, seed_sequence(r.seed)) for r in requests]
        x: Tensor | None = None
        steps = torch.full((len(requests),), STEPS, dtype=torch.int64, device=self.device.torch)
        rest: BatchRest | None = None
        for level in self.levels:
            x = self._begin(level, x, requests, randoms)
            last = level is self.levels[-1]
            options = NewtonOptions() if last else NewtonOptions(tolerance=1e-2, certify=False, iterations=60)
            rest = BatchNewton(level, options).minimise(x)
            x = rest.x
            steps += rest.iterations
        assert rest is not None
        level, everyone = self.levels[-1], torch.arange(len(requests), device=self.device.torch)
        energies = [level.energies(some, rest.x[some]) for some in torch.split(everyone, level.most)]
        return rest, torch.cat(energies), steps

    def _begin(
        self, level: BatchLevel, x: Tensor | None, requests: Sequence[Request], randoms: Sequence[Perturbation]
    ) -> Tensor:
        """Set a level up for the batch and give it positions to start from."""
        grid = level.grid
        pins = [Pins.of(grid, r.setup, p.pin_moves) for r, p in zip(requests, randoms, strict=True)]
        contacts = [
            PanelContact.of(
                grid.areas, r.fabric.density * GRAVITY_M_S2, r.setup.panel, r.mechanics.adhesion_pa,
                r.mechanics.adhesion_range_m,
            )
            for r in requests
        ]  # fmt: skip
        last = level is self.levels[-1]
        fabrics = [r.fabric if last else softened(r.fabric, grid, pin) for r, pin in zip(requests, pins, strict=True)]
        loads = [Load.of(grid, f, r.mechanics) for f, r in zip(fabrics, requests, strict=True)]
        cloths = [
            Cloths.one(grid, level.forms, fabric, request.mechanics, contact, pin.fixed)
            for fabric, request, contact, pin in zip(fabrics, requests, contacts, pins, strict=True)
        ]
        level.set_up(cloths, np.array([load.weight for load in loads]))
        held = BatchPins(pins, level)
        if x is None:
            x = put_up(level, held, randoms, np.stack([load.mass for load in loads]))
        else:
            coarse = self.device.get(x)
            x = self.device.put(np.stack([prolong(one, grid) for one in coarse]))
        x = held.hold(level, torch.arange(len(x), device=x.device), x, 1.0)
        guarded = level.free[..., 0] & level.panel[:, None, None]
        x[..., 2] = torch.where(guarded, x[..., 2].clamp(min=0.2 * REACH_M), x[..., 2])
        return x


def memory_bytes(mesh: GridMesh) -> int:
    """What a sample takes on the device by count: factors, their work space and the L-BFGS memory [bytes].

    49 MB at 10 mm and 341 MB at 5 mm. On an H100 256 samples took 42 MB each at their peak at 10 mm.
    """
    rows, columns = mesh.rows, mesh.columns
    blocks, size = math.ceil(rows / 2), 6 * columns
    return 8 * (2 * blocks * size * size + 4 * size * size + 120 * rows * columns * 3)
