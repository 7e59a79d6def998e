"""The blind check: sealed sets made, diagnosed, opened, counted and held against simpler methods."""
