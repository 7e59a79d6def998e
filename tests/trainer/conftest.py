"""A tiny configuration and a model trained with it, shared by the estimator's tests."""

from __future__ import annotations

import pytest

from trainer.config import AugmentConfig, NetworkConfig, TrainConfig
from trainer.model import TrainedModel
from trainer.train import train

from .analytic import AnalyticSource

TINY = TrainConfig(
    network=NetworkConfig(input_size=64, trunk_width=0.125, hidden=(32,), dropout=0.0),
    augment=AugmentConfig.off(),
    fusion_training="subsets",
    epochs=12,
    batch_size=32,
    learning_rate=4e-3,
    train_share=0.6,
    calibration_share=0.2,
)


@pytest.fixture(scope="session")
def analytic_source() -> AnalyticSource:
    return AnalyticSource()


@pytest.fixture(scope="session")
def tiny_config() -> TrainConfig:
    return TINY


@pytest.fixture(scope="session")
def tiny_model(analytic_source: AnalyticSource, tiny_config: TrainConfig) -> TrainedModel:
    """A model trained for some seconds, shared by the tests."""
    return train(analytic_source, tiny_config)
