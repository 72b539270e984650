"""Figures in the paper (Liu et al., Electronics 12 (2023), 2316), for comparison."""

INDICES = {
    "traditional": ((0.6747, 0.5467), (0.8523, 0.4037), (0.7492, 0.4127), (0.5339, 0.6531)),
    "rsc": ((0.7897, 0.428), (0.9005, 0.1214), (0.9423, 0.079), (0.8791, 0.3453)),
    "ours": ((0.8782, 0.3256), (0.9209, 0.0957), (0.9477, 0.0833), (0.8781, 0.3459)),
}
"""Table 1: SC and DB in each scene."""
DETECTION = {"traditional": (0.6307, 0.7287), "rsc": (0.7828, 0.8679), "ours": (0.8241, 0.8773)}
"""Table 2: ACC and FMI of 100 images."""
LIGHT_ACC = {"normal": 0.9172, "dim": 0.714}
"""ACC by light, of Section 4.3; Fig. 12 has no other numbers."""
DETECTORS = {
    "YOLOv7": (0.8147, 0.8360, 0.8296, 0.8438, 0.232),
    "Swin-Transformer YOLOv5": (0.8511, 0.9254, 0.80921, 0.8687, 0.224),
    "Ours": (0.8172, 0.8554, 0.9022, 0.8672, 0.053),
}
"""Table 3: ACC, precision, recall, F1, seconds per frame on a TX2."""
SUCCESS = {
    "strong": (0.782, 0.889, 0.946, 1.0, 1.0, 1.0),
    "normal": (0.873, 0.933, 0.971, 1.0, 1.0, 1.0),
    "weaker": (0.708, 0.828, 0.884, 0.925, 0.972, 1.0),
    "dim": (0.0, 0.0, 0.524, 0.773, 0.937, 1.0),
}
"""Table 4: success rate at 3, 2.5, 2, 1.5, 1.25 and 1 m."""
CANNY_MS = {(100, 200): 92.81, (125, 250): 83.55, (150, 300): 56.25}
"""Table 5: detection time by Canny thresholds [ms]."""
RATIO = {"rsc": "at least 2", "hierarchical_ward": "4 to 5"}
"""Fig. 11: clustering time divided by that of the paper's method."""
CYLINDER = "within 2 cm up to 3 m in normal light; about 2 cm from 1.5 to 2 m in other light"
"""Fig. 14: errors as stated in the text."""
