"""The floor: planes on the host, integer frames and units for the kernels, a log's sample."""
