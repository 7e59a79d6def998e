"""From measurements and responses to probabilities: errors, likelihoods, two effects, something unknown."""
