"""The two optimisation steps, shape and colour, and the optimiser that both use."""
