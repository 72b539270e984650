"""C++ and CUDA sources of kernels, from the headers in ``native/``."""

from pathlib import Path

FOLDER = Path(__file__).parent / "native"


def native(*headers: str, body: str) -> str:
    """The body of a native function: the structs of these headers, then a few lines that use them.

    Args:
        headers: Names in ``native/``, each after those it includes; ``team.h`` comes first always.
        body: C++, with the function's arguments in scope.
    """
    texts = [(FOLDER / name).read_text("utf-8") for name in ("team.h", *headers)]
    lines = [line for text in texts for line in text.splitlines()]
    kept = [line for line in lines if not line.startswith(("#include", "#pragma once"))]
    return "\n".join([*kept, body])
