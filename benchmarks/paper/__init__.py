"""The paper's experiments on simulated scenes, next to the paper's figures: one report.

``python -m benchmarks.paper`` runs all of them; each is one function in its own file.
"""
