"""Spawn keys by which what is random in a simulation draws apart under one seed; the drape draws from the seed itself.

Stores and pictures rest on them: a key keeps its number, and no other use gets it.
"""

from __future__ import annotations

SENSOR_STREAM = 1
"""The depth sensor's noise."""
EFFECT_STREAM = 2
"""Effects that are another one in every repeat."""
