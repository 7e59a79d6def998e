"""The dataset service: sweeps of fabrics, scenes and repeats into one store, on Ray."""
