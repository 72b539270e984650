"""Runs with mutated calibrations whose kernels are compiled with AddressSanitizer and UBSan.

Started by ``tests/test_native.py`` with the sanitizers' library loaded before all else, so that
the arrays that kernels get have red zones around them. Each kernel's C++, as Warp writes it, is
compiled by ``g++`` and takes the place of what Warp compiled. Where a kernel leaves an array or
does what C++ does not define, the process ends with a report.
"""

import ctypes
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import warp as wp
from warp._src import context

from jaxdet.engine import use_caches
from jaxdet.quiet import quiet_warp
from tests.fuzz.calibrations import Calibrations

FLAGS = ["-std=c++17", "-O1", "-g1", "-w", "-fPIC", "-shared", "-ffp-contract=off"]
SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
ASSERTING = 'extern "C" void _wp_assert(const char*, const char*, unsigned) { __builtin_trap(); }\n'
"""What Warp's own library has."""
FAULT = "{ volatile int* one = new int[1]; delete[] one; one[0] = 0; }"


class Sanitized:
    """Kernels from instrumented libraries.

    Args:
        folder: Where they are compiled.
        fault: Each kernel begins with an error, to see that it is found.
    """

    def __init__(self, folder: Path, *, fault: bool) -> None:
        self.folder, self.fault = folder, fault
        self.sources: dict[bytes, Path] = {}
        """By the handle of a module."""
        self.used: set[str] = set()
        """Kernels."""
        use_caches()
        quiet_warp()
        wp.init()
        compiled: Any = context.runtime.llvm
        self._load, compiled.wp_load_obj = compiled.wp_load_obj, self.load
        compiled.wp_lookup = self.lookup

    def load(self, path: bytes, handle: bytes, *more: Any) -> int:
        """Takes the place of Warp's function that loads a module."""
        [self.sources[handle]] = Path(path.decode()).parent.glob("*.cpp")
        return self._load(path, handle, *more)

    def lookup(self, handle: bytes, name: bytes) -> int | None:
        """Takes the place of Warp's function that finds a kernel; backward ones there are none."""
        if name.endswith(b"_cpu_backward"):
            return None
        self.used.add(name.decode())
        library = self.library(self.sources[handle])
        return ctypes.cast(getattr(library, name.decode()), ctypes.c_void_p).value

    @cache  # noqa: B019 (there is one of these)
    def library(self, source: Path) -> ctypes.CDLL:
        """The compiled kernels of a module."""
        path, text = self.folder / f"{source.stem}.so", source.read_text(encoding="utf-8")
        if self.fault:
            head, *bodies = text.split("_cpu_forward(")
            text = "_cpu_forward(".join([head, *(b.replace("{", "{" + FAULT, 1) for b in bodies)])
        native = Path(wp.__file__).parent / "native"
        command = ["g++", *FLAGS, *SANITIZERS, "-I", str(native), "-x", "c++", "-", "-o", str(path)]
        subprocess.run(command, input=text + ASSERTING, text=True, check=True)
        return ctypes.CDLL(str(path))


def main(folder: Path, seeds: range, *, fault: bool) -> None:
    """Runs the calibrations of some seeds; none may fail."""
    kernels = Sanitized(folder, fault=fault)
    calibrations, ends = Calibrations(folder), set()
    for seed in seeds:
        print(f"seed {seed}", file=sys.stderr, flush=True)
        case = calibrations.one(seed)
        assert not case.verdict.failed or case.verdict.kind == "hang", case
        ends.add(case.verdict.kind)
    print(f"{len(seeds)} calibrations, {len(kernels.used)} kernels: {sorted(ends)}")


if __name__ == "__main__":
    first, last = map(int, sys.argv[2:4])
    main(Path(sys.argv[1]), range(first, last), fault="fault" in sys.argv)
