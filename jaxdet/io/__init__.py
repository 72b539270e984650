"""Logs of depth cameras: MCAP files to arrays, and arrays to files."""
