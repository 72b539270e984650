"""Geometry of floors: planes on the host, integer frames and units, median of sampled floors.

``jaxdet/reference/_floor.py`` estimates the floor of a frame, and ``jaxdet/engine/floors.py``
determines the prior of a log.
"""
