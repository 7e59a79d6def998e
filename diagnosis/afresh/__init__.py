"""Second looks: the likeliest explanations simulated again, at their fitted sizes, and held against the captures."""
