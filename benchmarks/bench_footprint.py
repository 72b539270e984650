"""Benchmark of the outlines of point clusters, against the reference."""

import jax

from benchmarks.points import camera, plane_of, points, settings
from benchmarks.run import Case
from benchmarks.scene import BATCH
from benchmarks.sweep import DEFAULT_SLOTS, Point
from jaxdet import reference, stages
from jaxdet.presets import preset

PAPER = preset("paper")
UNIT = camera().depth_unit


def cases() -> list[Case]:
    """Process one batch of labelled features on the device; no other library has this step."""
    host, plane = points(BATCH, DEFAULT_SLOTS), plane_of(BATCH)
    config = settings(PAPER, DEFAULT_SLOTS)
    labels = reference.paper.cluster(host, UNIT, config)
    return [
        at(Point("", DEFAULT_SLOTS, BATCH))._replace(
            name="vs_reference",
            peer=lambda: reference.paper.footprint(host, labels, plane, UNIT, config),
            equal=True,
            bytes_read=0,
        )
    ]


def at(point: Point) -> Case:
    """Process frames of ``slots`` labelled points on the device."""
    features, plane = jax.device_put(points(point.batch, point.slots)), plane_of(point.batch)
    config = settings(PAPER, point.slots)
    labels = jax.block_until_ready(stages.paper.cluster(features, UNIT, config))
    read = *features[:5], features.kept, labels.labels
    return Case(
        name=point.name,
        run=lambda: stages.paper.footprint(features, labels, plane, UNIT, config),
        frames=point.batch,
        bytes_read=sum(a.nbytes for a in read),
    )
