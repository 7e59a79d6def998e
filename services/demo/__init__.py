"""The demonstration: the whole chain, small, on embedded defaults, step by step into one folder."""
