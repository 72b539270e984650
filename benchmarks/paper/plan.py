"""What is drawn: seeds, scenes, lights, distances, and how many of each."""

from dataclasses import dataclass

TUNING_SEEDS = tuple(range(100, 110))
"""Parameters are chosen on these and on no others."""
TEST_SEEDS = tuple(range(1000, 1020))
"""The report's figures come from these and from no others. 900 to 919 were the test seeds of an
earlier default and may be used for tuning."""
REHEARSAL_SEEDS = tuple(range(500, 520))
"""For looking at the report while the method is still being changed (``--rehearsal``)."""
PRESET_SEEDS = tuple(range(6000, 6012))
"""The preset ``paper`` was judged on these once, after it had been chosen on the tuning seeds."""
SCENES = ("people_and_vehicle", "roadblocks", "bucket", "tree_trunk")
"""The paper's four scenes, as families of :mod:`jaxdet.sim`."""
SCENE_TITLES = ("People and vehicle", "Roadblocks", "Bucket", "Tree trunk")
LIGHTS = ("strong", "normal", "weaker", "dim")
DISTANCES_M = (3.0, 2.5, 2.0, 1.5, 1.25, 1.0)
"""Of the paper's Table 4."""
CANNY_BOUNDS = ((100, 200), (125, 250), (150, 300))
"""Of the paper's Table 5."""
PITCHES_DEG = (0.0, 10.0, 25.0)
ROLLS_DEG = (0.0, 12.0)
SLOPES_DEG = (-4.0, 0.0, 4.0)


@dataclass(frozen=True)
class Counts:
    """How much is drawn; every draw is a new scene."""

    scenes: int = 2
    """Scenes a test seed of each of the four families, each in all lights."""
    test_seeds: int = 5
    """Test seeds used; experiments may use fewer of them."""
    tuning_seeds: int = 4
    """Tuning seeds used, one scene each of each family and light."""
    approach: int = 1
    """Scenes a test seed in each cell of Table 4."""
    cylinder_seeds: int = 12
    """Test seeds used, one scene each in each cell of Fig. 14."""
    floor_seeds: int = 2
    """Test seeds used, one scene each for each tilt, roll and slope."""
    hard_seeds: int = 20
    """Test seeds used for the harder families."""
    hard_scenes: int = 1
    """Scenes a test seed of each harder family, each with a clean and a real depth camera."""
    mount_seeds: int = 5
    """Test seeds whose scenes in normal light are looked at with each wrong mount."""
    case_seeds: int = 4
    """Test seeds used, one scene each of each case."""
    log_frames: int = 48
    """Frames of the log with the pedestrian."""
    timed: int = 8
    """Frames that are timed in each condition."""
    rounds: int = 5
    """How often they are timed."""
    width: int = 640
    """Of the images; the height is three quarters of it [pixel]."""
    worst: int = 8
    """Failing frames that are pictured."""


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
