"""Logs that are changed at random, and what may come of them."""
