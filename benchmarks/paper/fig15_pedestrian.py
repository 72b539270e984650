"""Fig. 15: a pedestrian on the map of a moving robot."""

import numpy as np
from matplotlib.axes import Axes

from benchmarks.paper import plots
from benchmarks.paper.lab import Lab
from benchmarks.paper.pictures import encode, frame_picture, grid, scaled
from benchmarks.paper.section import Section, bootstrap, percent, wilson
from benchmarks.paper.shots import Shot, frames_of
from benchmarks.paper.systems import Prepared, System, default, found_by, paper, tally_of
from jaxdet.eval import total
from jaxdet.render import draw_map
from jaxdet.results.metric import rectangles, to_world
from jaxdet.results.occupancy import OccupancyMap
from jaxdet.sim import load_scene

RATE_HZ = 8.0
PERSON = "person"


def run(lab: Lab) -> Section:
    """Fig. 15 (a) the pedestrian in the camera's picture, (b) the obstacles on the map."""
    section = Section("fig15", "Fig. 15: a pedestrian on the map")
    seed = lab.seeds[0]
    spec = lab.spec("pedestrian", seed, lab.counts.log_frames, log=True, rate_hz=RATE_HZ)
    shots = lab.load([spec])
    section.say(
        f"A simulated log of {len(shots)} frames at {RATE_HZ:g} Hz: the robot moves 1.6 m "
        "forward and back, and a person crosses at 1.2 m/s. The paper shows one scene and gives no "
        "figures."
    )
    for system in (default(lab.config), paper()):
        _system(section, system, shots, seed)
    return section


def _system(section: Section, system: System, shots: list[Shot], seed: int) -> None:
    """Add the figures, pictures and maps of one system."""
    results = found_by(system, Prepared(shots))
    config = system.config
    corners: list[np.ndarray] = []
    occupancy = OccupancyMap()
    tallies = []
    for shot, found in zip(shots, results, strict=True):
        outline = rectangles(found.obstacles, shot.calibration.depth_unit, config.footprint)
        count = int(found.num_obstacles[0])
        pose = shot.T_world_color if config.cluster.points else shot.T_world_camera
        world = to_world(outline, pose[None])[0, :count]
        corners.append(world)
        occupancy.add(world.reshape(-1, 8).astype(np.float32))
        occupancy.add_path(shot.T_world_camera[None])
        tallies.append(tally_of(shot, found, config))
    _figures(section, system, shots, tallies)
    pictures = []
    for index in np.linspace(0, len(shots) - 1, 4).round().astype(int).tolist():
        frame, found = frames_of([shots[index]]), results[index]
        title = f"pedestrian, frame {index}, {index / RATE_HZ:.1f} s"
        pictures.append(scaled(frame_picture(frame, found, config, title), 640))
    caption = f"Fig. 15 (a), {system.title}: the pedestrian as seen from the robot, in four frames."
    section.picture(f"{system.name}_frames", encode(grid(pictures, 2)), caption)
    _map(section, system, shots, corners, seed)
    image = occupancy.image()
    if image is not None:
        drawn = draw_map(image, "pedestrian")
        caption = f"{system.title}: the occupancy map of the run."
        section.picture(f"{system.name}_counts", encode(drawn), caption)


def _figures(section: Section, system: System, shots: list[Shot], tallies: list) -> None:
    walker = shots[0].names.index(PERSON) + 1
    cases = [case for case in total(tallies).cases if case.number == walker]
    found = [case for case in cases if case.found]
    off = np.abs([case.position_error_m for case in found])
    ends = wilson(len(found), len(cases))
    rate = len(found) / len(cases) if cases else float("nan")
    middle = float(np.median(off)) if len(off) else float("nan")
    section.add(f"{system.name}.person.found", rate, "", "higher", ends)
    section.add(f"{system.name}.person.position", middle, "m", "lower", bootstrap(off, 0.5))
    section.say(
        f"{system.title}: the person was found in {len(found)} of the {len(cases)} frames in which "
        f"it is required ({percent(rate, ends)}); the median error of the forward distance of its "
        f"point C is {100 * middle:.1f} cm."
    )


def _map(
    section: Section, system: System, shots: list[Shot], corners: list[np.ndarray], seed: int
) -> None:
    """Add the map of the walls with the detected outlines."""
    figure, axes = plots.canvas(1, 8, 5.6)
    ax = axes[0]
    scene = load_scene("pedestrian", seed)
    for wall in scene.walls:
        ax.plot(*zip(wall.start, wall.end, strict=True), color=plots.INK, lw=3)
    for world in corners:
        for polygon in world:
            ax.fill(*polygon.T, color=plots.OURS, alpha=0.10, lw=0)
    _true_outlines(ax, shots)
    way = np.array([shot.T_world_camera[:2, 3] for shot in shots])
    ax.plot(*way.T, color=plots.COLORS[2], lw=2, label="robot")
    ax.plot([], [], color=plots.OURS, lw=6, alpha=0.4, label="detected outlines, all frames")
    ax.set_aspect("equal")
    ax.set_xlim(-0.6, 6.0)
    ax.set_ylim(-2.6, 2.6)
    ax.set_xlabel("world X [m]")
    ax.set_ylabel("world Y [m]")
    ax.legend(loc="upper left", fontsize=8, frameon=True)
    caption = f"Fig. 15 (b), {system.title}: outlines of all frames on the map, by Eq. 8-9."
    section.picture(f"{system.name}_map", plots.png(figure), caption)


def _true_outlines(ax: Axes, shots: list[Shot]) -> None:
    """Draw the true outlines: static objects once, the person every half second."""
    step = max(1, round(RATE_HZ / 2))
    label = "true outlines"
    for shot in shots[::step]:
        outline = shot.truth.footprint
        assert outline is not None
        for number, name in enumerate(shot.names):
            still = name != PERSON
            if shot.truth.is_wall[number] or (still and shot is not shots[0]):
                continue
            known = outline[:, number][np.isfinite(outline[:, number]).all(axis=-1)]
            ring = to_world(known[None, None], shot.T_world_camera[None])[0, 0]
            if len(ring):
                ring = np.concatenate([ring, ring[:1]])
                ax.plot(*ring.T, color=plots.COLORS[1], lw=1, label=label)
                label = None
