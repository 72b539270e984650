"""Tables and settings of kernels: int32, nothing longer than any length."""

import numpy as np
from numpy.typing import ArrayLike

from jaxdet.types import Array

LIMIT = 1 << 30  # of a setting or of an entry of a table: no length is longer

Tables = dict[str, Array]
"""The tables and settings of a step, by the names in ``program.h``."""


def kernel_table(values: ArrayLike) -> np.ndarray:
    """A table or settings as kernels take them: int32, nothing above ``LIMIT``."""
    return np.minimum(values, LIMIT).astype(np.int32)


def kernel_tables(**values: ArrayLike) -> Tables:
    """The same of several, by name."""
    return {name: kernel_table(one) for name, one in values.items()}
