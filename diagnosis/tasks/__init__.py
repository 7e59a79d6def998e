"""From a capture set to the simulations that the diagnosis of each fabric needs."""
