"""The training loop: a source of pictures in, a trained model out. Read it from top to bottom."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from simcore.scenes import Scene
from trainer.augment import Augmenter
from trainer.calibrate import calibrate
from trainer.checkpoint import Checkpoint, CheckpointFile, is_due
from trainer.config import TrainConfig
from trainer.dataset import (
    SCENES,
    Batch,
    PairStream,
    Partition,
    PictureSource,
    PictureTable,
    Shown,
    batches,
    check_lanes,
    pair_up,
)
from trainer.distributed import average_gradients, average_statistics, broadcast_state, on_first
from trainer.evaluate import evaluate
from trainer.model import TrainedModel, round_weights
from trainer.network import DrapeNetwork, Features, fuse
from trainer.preprocess import network_images
from trainer.pretrained import BaseWeights, load_pretrained_trunk
from trainer.same_run import description
from trainer.split import MaterialSplit, split_materials
from trainer.targets import TargetScaling

SUBSETS: dict[str, tuple[tuple[int, ...], ...]] = {"single": ((0,), (1,)), "subsets": ((0,), (1,), (0, 1))}
"""Scene sets that the loss sees, by ``TrainConfig.fusion_training``."""

_AUGMENT_STREAM, _WEIGHTS_STREAM = 3, 4
SPREAD_LOSS_WEIGHT = 0.1
_HANGING = SCENES.index(Scene.HANGING)


@dataclass(frozen=True)
class Progress:
    """State of a run after a step.

    Attributes:
        step, steps: optimiser steps done and to do.
        loss: mean squared error of the standardised targets, averaged over the recent steps.
    """

    step: int
    steps: int
    loss: float


@dataclass(frozen=True)
class Learnt:
    """A network behind its last step, with what it was taught from and how; not calibrated yet."""

    config: TrainConfig
    network: DrapeNetwork
    source: PictureSource
    table: PictureTable
    split: MaterialSplit
    scaling: TargetScaling
    provenance: dict[str, Any]


def train(
    source: PictureSource,
    config: TrainConfig = TrainConfig(),
    *,
    start: TrainedModel | None = None,
    provenance: dict[str, Any] | None = None,
    report: Callable[[Progress], None] | None = None,
    checkpoints: CheckpointFile | None = None,
) -> TrainedModel:
    """Train, calibrate the intervals and test on held-out materials.

    The same configuration, source and number of threads give the same model.

    Args:
        source: pictures with their parameters.
        config: every choice; the network's are the earlier model's where there is one, and not ``pretrained`` then.
        start: an earlier model to go on from, with its scaling of the targets; left as it is.
        provenance: where the pictures came from, kept with the model.
        report: called after each step.
        checkpoints: where the state is kept now and then, and gone on from where that is asked for.

    Raises:
        InputError: too few materials, fewer shards than loaders, or a checkpoint of another training.
        StoreError: a picture cannot be read; of those held out this is found before the first step.
    """
    return finish(learn(source, config, start=start, provenance=provenance, report=report, checkpoints=checkpoints))


def learn(
    source: PictureSource,
    config: TrainConfig,
    *,
    partition: Partition = Partition(),
    start: TrainedModel | None = None,
    provenance: dict[str, Any] | None = None,
    report: Callable[[Progress], None] | None = None,
    checkpoints: CheckpointFile | None = None,
) -> Learnt:
    """Fit a network to the training materials.

    Args:
        partition: this process's share of the shards, when several train together (``torch.distributed`` is up then).
        checkpoints: of one process that trains alone.

    Raises:
        InputError: too few materials, fewer shards than loaders, or a checkpoint of another training.
        StoreError: a held-out picture cannot be read; nothing was learnt then.
    """
    torch.set_num_threads(config.threads)
    if start is not None:  # its weights, whatever they began with: the record says that of the earlier model
        config = replace(config, network=start.config.network, pretrained=False)
    table = source.table()
    split = split_of(table, config, start)
    training = training_pictures(table, split, config)
    check_lanes(training, partition.world_size * max(1, config.workers))
    record: dict[str, Any] = {"data": provenance or {}, "torch": torch.__version__}
    known = start.provenance.get("learnt", ()) if start is not None else ()
    record["learnt"] = sorted({*learnt_fabrics(training).values(), *known})
    if start is None:
        scaling = TargetScaling.fit(training.material_parameters(), config.network.targets)
        network, base = build_network(config)
        record["base_weights"] = asdict(base) if base else None
    else:
        scaling, network = start.scaling.knowing(training.material_parameters()), deepcopy(start.network)
        record["base_weights"] = start.provenance.get("base_weights")
        earlier = {name: value for name, value in start.provenance.items() if name != "learnt"}
        record["start"] = {"model_version": start.version, "provenance": earlier}
    begun, keep = None, None
    if checkpoints is not None:
        run = description(config, table, split, record)
        begun, keep = checkpoints.read(run), partial(checkpoints.write, run)
    on_first(lambda: check_held_out(source, table, split, config), partition)
    broadcast_state(network, partition)
    fit(
        network,
        pairs_behind(begun, source, training, config, partition),
        steps_of(training, config, partition),
        config,
        scaling,
        partition=partition,
        report=report,
        begun=begun,
        keep=keep,
    )
    return Learnt(config, network, source, table, split, scaling, record)


def split_of(table: PictureTable, config: TrainConfig, start: TrainedModel | None = None) -> MaterialSplit:
    """The run's split of the materials; what an earlier model learnt from is not held out.

    Raises:
        InputError: too few materials, or too few that the earlier model has not learnt from.
    """
    learnt = set() if start is None else set(start.provenance.get("learnt", ()))
    return split_materials(
        table.material,
        seed=config.seed,
        train_share=config.train_share,
        calibration_share=config.calibration_share,
        known=[number for number, name in learnt_fabrics(table).items() if name in learnt] if learnt else (),
    )


def learnt_fabrics(table: PictureTable) -> dict[int, str]:
    """By material number, a short hash of the fabric's seven parameters (as float32): what it is in any store."""
    numbers, first = np.unique(table.material, return_index=True)
    values = table.parameters[first].astype("<f4")
    return {
        int(number): hashlib.sha256(row.tobytes()).hexdigest()[:12] for number, row in zip(numbers, values, strict=True)
    }


def training_pictures(table: PictureTable, split: MaterialSplit, config: TrainConfig) -> PictureTable:
    """What the run learns from."""
    training = table.of_materials(split.train)
    return training.upright() if config.inclinations == "upright" else training


def judged_pictures(table: PictureTable, config: TrainConfig) -> PictureTable:
    """What a finished network is calibrated and tested on, of all materials."""
    return table.upright() if config.inclinations == "upright" else table


def check_held_out(source: PictureSource, table: PictureTable, split: MaterialSplit, config: TrainConfig) -> None:
    """Read the pictures to calibrate and to test on once: training reads none of them, and takes hours.

    Raises:
        StoreError: one is lost or damaged.
    """
    held_out = judged_pictures(table, config).of_materials(np.concatenate([split.calibration, split.test]))
    for shard in np.unique(held_out.shard):
        source.read(held_out.row[held_out.shard == shard])


def finish(learnt: Learnt) -> TrainedModel:
    """Round the weights to what is stored, then calibrate and test exactly that network."""
    config, network, scaling = learnt.config, learnt.network, learnt.scaling
    if config.half_precision_weights:
        round_weights(network)
    table = judged_pictures(learnt.table, config)
    calibration = calibrate(network, learnt.source, table, learnt.split, config, scaling)
    metrics = evaluate(network, learnt.source, table, learnt.split, scaling, calibration.intervals)
    return TrainedModel(
        config, network, scaling, calibration.intervals, calibration.outliers, metrics, learnt.provenance
    )


def build_network(config: TrainConfig) -> tuple[DrapeNetwork, BaseWeights | None]:
    """A network before training and the weights it started from, if any; random ones depend on the seed alone."""
    base = None
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(_seed(config.seed, _WEIGHTS_STREAM))
        network = DrapeNetwork(config.network)
        if config.pretrained:
            base = load_pretrained_trunk(network.trunk)
    return network, base


def pairs_of_batch(training: PictureTable, config: TrainConfig) -> int:
    """Pairs that hold ``batch_size`` pictures in the mean: half as many, all where a store has one scene alone."""
    return max(1, math.floor(config.batch_size * len(pair_up(training, None)) / max(1, len(training))))


def pairs_behind(
    begun: Checkpoint | None, source: PictureSource, training: PictureTable, config: TrainConfig, partition: Partition
) -> Iterator[Batch]:
    """What a training learns from, in batches; the rest of it where one was begun."""
    pairs = pairs_of_batch(training, config)
    shown = Shown(0 if begun is None else begun.step, pairs)
    size = config.network.input_size
    stream = PairStream(source, training, size=size, seed=config.seed, partition=partition, shown=shown)
    return batches(stream, pairs, config.workers)


def steps_of(training: PictureTable, config: TrainConfig, partition: Partition) -> int:
    """Optimiser steps of the whole run."""
    pictures = len(training)
    if config.pictures_per_epoch:
        pictures = min(pictures, config.pictures_per_epoch)
    return config.epochs * max(1, math.ceil(pictures / (config.batch_size * partition.world_size)))


def fit(
    network: DrapeNetwork,
    pairs: Iterable[Batch],
    steps: int,
    config: TrainConfig,
    scaling: TargetScaling,
    *,
    partition: Partition = Partition(),
    report: Callable[[Progress], None] | None = None,
    begun: Checkpoint | None = None,
    keep: Callable[[Checkpoint], None] | None = None,
) -> None:
    """The loop itself: AdamW, linear warm-up, cosine to zero, gradients clipped at norm 1.

    Args:
        pairs: the batches that are still to be learnt from.
        begun: the state to go on from; it replaces the network's.
        keep: called with the state now and then.
    """
    augment = Augmenter(config.augment)
    optimiser = torch.optim.AdamW(network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)
    warmup = max(1, round(config.warmup_share * steps))
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda step: _learning_share(step, steps, warmup))
    network.train()
    done, recent = 0, math.nan
    if begun is not None:
        begun.restore(network, optimiser, schedule)
        done, recent, pairs = begun.step, begun.recent, begun.with_generator(pairs)
    with torch.random.fork_rng(devices=[]):  # dropout draws from the global generator
        torch.manual_seed(_seed(config.seed, _AUGMENT_STREAM, partition.rank))
        for step, batch in zip(range(done, steps), pairs, strict=False):
            seed = _seed(config.seed, _AUGMENT_STREAM, partition.rank, step)
            flat = augment(mirror_hanging(batch.pictures, config.mirror, seed)[batch.present], seed)
            features = network.extract_by_scene(network_images(flat, config.network), batch.present)
            error, spread_loss = losses(network, features, batch, scaling, SUBSETS[config.fusion_training])
            optimiser.zero_grad(set_to_none=True)
            (error + SPREAD_LOSS_WEIGHT * spread_loss).backward()  # type: ignore[no-untyped-call]  # torch's own stub
            average_gradients(network, partition)
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            schedule.step()
            value = float(error.detach())
            recent = value if math.isnan(recent) else 0.95 * recent + 0.05 * value
            if keep is not None and is_due(step + 1, steps):
                keep(Checkpoint.of(step + 1, recent, network, optimiser, schedule))
            if report is not None:
                report(Progress(step + 1, steps, recent))
    average_statistics(network, partition)
    network.eval()


def mirror_hanging(pictures: Tensor, share: float, seed: int) -> Tensor:
    """Show a share of the hanging pictures in the mirror: the scene is symmetric and so are orthotropic fabrics.

    Args:
        pictures: shape [pairs, scenes, 1, H, W].
    """
    if not share:
        return pictures
    drawn = np.random.default_rng(np.random.SeedSequence(seed)).random(len(pictures)) < share
    chosen = torch.from_numpy(drawn)[:, None, None, None]
    hanging = torch.where(chosen, pictures[:, _HANGING].flip(-1), pictures[:, _HANGING])
    return torch.stack([hanging if s == _HANGING else pictures[:, s] for s in range(pictures.shape[1])], dim=1)


def losses(
    network: DrapeNetwork,
    features: Features,
    batch: Batch,
    scaling: TargetScaling,
    subsets: tuple[tuple[int, ...], ...],
) -> tuple[Tensor, Tensor]:
    """Mean squared error (the paper's loss) and the spread's likelihood, over the scene sets that are there.

    Args:
        network: whose regressor is applied.
        features: of every picture, shape [pairs, scenes, channels] each; zero where absent.
        batch: the pairs.
        scaling: of targets and density.
        subsets: scene sets that the loss sees, as indices into ``SCENES``.

    Returns:
        Both averaged over scene sets, pairs and the six standardised targets, float32, shape [].
    """
    truth = torch.from_numpy(scaling.encode(batch.parameters.numpy())).float()
    density = torch.from_numpy(scaling.encode_density(batch.parameters[:, 6].numpy())).float()
    errors, likelihoods = [], []
    for subset in subsets:
        rows = batch.present[:, list(subset)].all(dim=1)
        if not rows.any():
            continue
        shown = torch.zeros_like(batch.present[rows])
        shown[:, list(subset)] = True
        fused = fuse(Features(features.maximum[rows], features.mean[rows]), shown)
        mean, log_spread = network.regress(fused, density[rows])
        squared = (mean - truth[rows]) ** 2
        errors.append(squared)
        likelihoods.append(0.5 * squared.detach() * torch.exp(-2 * log_spread) + log_spread)
    return torch.cat(errors).mean(), torch.cat(likelihoods).mean()


def _learning_share(step: int, steps: int, warmup: int) -> float:
    if step < warmup:
        return (step + 1) / warmup
    return 0.5 * (1.0 + math.cos(math.pi * (step - warmup) / max(1, steps - warmup)))


def _seed(*path: int) -> int:
    return int(np.random.SeedSequence(path[0], spawn_key=path[1:]).generate_state(1)[0])
