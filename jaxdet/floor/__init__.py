"""Floor: planes on the host, integer frames and units for the kernels, sampled floor of a log."""
