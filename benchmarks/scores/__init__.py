"""Scores that only the experiments need: boxes of real frames, intervals, groups of objects."""
