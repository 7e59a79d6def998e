"""Fold states, kept on disk, and what parameters, magnets, the mesh and every effect change in them."""
