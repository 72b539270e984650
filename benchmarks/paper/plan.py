"""Seeds, scenes, lights and distances of the experiments, and the number of each."""

from dataclasses import dataclass

TUNING_SEEDS = tuple(range(100, 110))
"""Seeds on which parameters are chosen."""
TEST_SEEDS = tuple(range(1000, 1020))
"""Seeds of the figures of the report. 900 to 919 were the test seeds of an earlier default and may
be used for tuning."""
REHEARSAL_SEEDS = tuple(range(500, 520))
"""Seeds for reports during work on the method (``--rehearsal``)."""
PRESET_SEEDS = tuple(range(6000, 6012))
"""Seeds on which the preset ``paper`` was evaluated, once its parameters had been chosen."""
SCENES = ("people_and_vehicle", "roadblocks", "bucket", "tree_trunk")
"""The paper's four scenes, as families of :mod:`jaxdet.sim`."""
SCENE_TITLES = ("People and vehicle", "Roadblocks", "Bucket", "Tree trunk")
LIGHTS = ("strong", "normal", "weaker", "dim")
DISTANCES_M = (3.0, 2.5, 2.0, 1.5, 1.25, 1.0)
"""Distances of the paper's Table 4."""
CANNY_BOUNDS = ((100, 200), (125, 250), (150, 300))
"""Canny thresholds of the paper's Table 5."""
PITCHES_DEG = (0.0, 10.0, 25.0)
ROLLS_DEG = (0.0, 12.0)
SLOPES_DEG = (-4.0, 0.0, 4.0)


@dataclass(frozen=True)
class Counts:
    """Numbers of scenes and frames; each is simulated separately."""

    scenes: int = 2
    """Scenes per test seed and family, each in all lights."""
    test_seeds: int = 5
    """Number of test seeds; some experiments use fewer."""
    tuning_seeds: int = 4
    """Number of tuning seeds, with one scene per family and light."""
    approach: int = 1
    """Scenes per test seed and cell of Table 4."""
    cylinder_seeds: int = 12
    """Number of test seeds of Fig. 14, with one scene per cell."""
    floor_seeds: int = 2
    """Number of test seeds of the floor, with one scene per pitch, roll and slope."""
    hard_seeds: int = 20
    """Number of test seeds of the harder families."""
    hard_scenes: int = 1
    """Scenes per test seed and harder family, each without and with depth errors."""
    mount_seeds: int = 5
    """Number of test seeds of the wrong mounts, in normal light."""
    case_seeds: int = 4
    """Number of test seeds; each seed has one scene per case."""
    log_frames: int = 48
    """Number of frames of the log with the pedestrian."""
    timed: int = 8
    """Number of frames that are timed per condition."""
    rounds: int = 5
    """Number of times that each frame is timed."""
    width: int = 640
    """Width of the images [pixel]; the height is three quarters of it."""
    worst: int = 8
    """Number of frames with errors that are shown as pictures."""


QUICK = Counts()
FULL = Counts(
    scenes=10,
    test_seeds=len(TEST_SEEDS),
    tuning_seeds=10,
    approach=5,
    cylinder_seeds=20,
    floor_seeds=10,
    hard_scenes=5,
    mount_seeds=20,
    case_seeds=10,
    log_frames=120,
    timed=48,
    rounds=9,
    worst=24,
)
