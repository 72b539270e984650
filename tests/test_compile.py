"""Kernels that are compiled by several processes."""

import subprocess
import sys
from pathlib import Path

_HELPED = '''
import sys, time
import warp as wp
from jaxdet.quiet import quiet_warp
quiet_warp()
wp.config.kernel_cache_dir = sys.argv[1]
from jaxdet.stages import _compile
from jaxdet_kernels import cover, free_floor
_compile._MODULES = cover, free_floor
_compile.threads = lambda: 2


def load_module(module, device):
    """This process compiles nothing, and is as long at it as the other."""
    until = time.monotonic() + 60
    while time.monotonic() < until and not any(map(_compile._is_kept, _compile._MODULES)):
        time.sleep(0.05)


wp.load_module = load_module
_compile.compile_method()
print(*(module.__name__ for module in _compile._MODULES if _compile._is_kept(module)))
'''


def test_another_process_compiles_what_this_one_looks_for(tmp_path: Path) -> None:
    """Both see the same name for the same code; the rest is compiled when it is called."""
    command = [sys.executable, "-c", _HELPED, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    kept = done.stdout.split()
    assert len(kept) == 1 and kept[0].startswith("jaxdet_kernels."), done.stdout
    assert len(list(tmp_path.glob("*/*.o"))) == 1
