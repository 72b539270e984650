"""Autoencoder of descriptors of the points of one frame: position and image patch.

It is small and trained on one frame with JAX, always with the same initial weights. DDC and DCC use
it.
"""

from typing import Any

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.baselines.frames import Frame, points_of

SAMPLE = 160
"""Maximum number of points trained on; t-SNE and the distances of n points take at least O(n^2)."""
WIDTHS = (32, 4)
"""Widths of the encoder's layers; the decoder's are the same in reverse order."""
PRETRAINING = 200
"""Number of steps of Adam for the autoencoder alone."""
RATE = 0.01
"""Learning rate of Adam: larger than the papers' because there are fewer steps."""

Net = list[tuple[jax.Array, jax.Array]]
"""Weights and biases of the encoder's layers, then of the decoder's layers."""


def descriptors(frame: Frame, depth_scale: float, grey_m: float, patch: int = 9) -> np.ndarray:
    """Return a descriptor of each feature above the floor: position and grey patch.

    Args:
        frame: The frame.
        depth_scale: Factor for z.
        grey_m: Distance that the difference between black and white is equivalent to [m].
        patch: Side of the patch [pixel].

    Returns:
        Descriptors ``(n, 6)`` float32 [m]: x and z; mean and standard deviation of the grey patch;
        means of the absolute values of its derivatives along x and y.
    """
    kept = frame.features.kept[0]
    u, v = frame.features.u[0, kept], frame.features.v[0, kept]
    grey = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    slopes = (cv2.Sobel(grey, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    side = (patch, patch)
    mean = cv2.blur(grey, side)
    spread = np.sqrt(np.maximum(cv2.blur(grey * grey, side) - mean * mean, 0))
    appearance = [mean, spread, *(cv2.blur(np.abs(slope), side) for slope in slopes)]
    place = points_of(frame) * [1, depth_scale]
    values = [grey_m * image[v, u] for image in appearance]
    return np.column_stack([place, *values]).astype(np.float32)


def encode(points: np.ndarray) -> np.ndarray:
    """Return the codes of points by an autoencoder trained on them.

    Args:
        points: Descriptors ``(m, d)`` float32, m <= ``SAMPLE``.

    Returns:
        Codes ``(m, c)`` float32.
    """
    return np.asarray(code_of(pretrained(points), padded(points)))[: len(points)]


def pretrained(points: np.ndarray) -> Net:
    """Return an autoencoder trained on points, always with the same initial weights."""
    return _pretrained(padded(points), len(points))


def padded(points: np.ndarray) -> np.ndarray:
    """Centre the points and pad them to ``SAMPLE``, so that one program serves all frames."""
    return np.pad(points - points.mean(axis=0), ((0, SAMPLE - len(points)), (0, 0)))


def _start(width: int) -> Net:
    """Return the initial layers: weights by He et al., biases 0."""
    widths = (width, *WIDTHS, *WIDTHS[-2::-1], width)
    keys = jax.random.split(jax.random.key(0), len(widths) - 1)
    return [
        (jax.random.normal(key, (a, b)) * (2 / a) ** 0.5, jnp.zeros(b))
        for key, a, b in zip(keys, widths[:-1], widths[1:], strict=True)
    ]


def _apply(layers: Net, x: jax.Array) -> jax.Array:
    for number, (weights, bias) in enumerate(layers):
        x = x @ weights + bias[None]
        x = jax.nn.relu(x) if number < len(layers) - 1 else x
    return x


@jax.jit
def code_of(net: Net, points: jax.Array) -> jax.Array:
    """Return the encoder's output ``(m, c)`` for points ``(m, d)``."""
    return _apply(net[: len(WIDTHS)], points)


def rebuilt(net: Net, code: jax.Array) -> jax.Array:
    """Return the decoder's output ``(m, d)`` for codes ``(m, c)``."""
    return _apply(net[len(WIDTHS) :], code)


def adam(loss: Any, start: Any, steps: int) -> Any:
    """Minimise ``loss(value, step)`` by some steps of Adam (Kingma and Ba, ICLR 2015).

    Args:
        loss: Differentiable function; ``step`` is int32 and starts at 0.
        start: Initial value, a tree of arrays.
        steps: Number of steps.
    """
    zeros = jax.tree.map(jnp.zeros_like, start)

    def step(number: jax.Array, state: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        value, mean, square = state
        slope = jax.grad(loss)(value, number)
        mean = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, mean, slope)
        square = jax.tree.map(lambda s, g: 0.999 * s + 0.001 * g * g, square, slope)
        age = number.astype(jnp.float32) + 1
        rate = RATE * jnp.sqrt(1 - 0.999**age) / (1 - 0.9**age)
        value = jax.tree.map(
            lambda v, m, s: v - rate * m / (jnp.sqrt(s) + 1e-8), value, mean, square
        )
        return value, mean, square

    return jax.lax.fori_loop(0, steps, step, (start, zeros, zeros))[0]


@jax.jit
def _pretrained(points: jax.Array, count: int) -> Net:
    real = (jnp.arange(SAMPLE) < count).astype(jnp.float32)

    def loss(net: Net, step: jax.Array) -> jax.Array:
        del step
        error = jnp.sum((rebuilt(net, code_of(net, points)) - points) ** 2, axis=1)
        return jnp.sum(real * error) / (count * points.shape[1])

    return adam(loss, _start(points.shape[1]), PRETRAINING)
