"""Kernels that are compiled by several processes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

_MODULES = """
import sys, time
import warp as wp
from jaxdet.quiet import quiet_warp
quiet_warp()
wp.config.kernel_cache_dir = sys.argv[1]
from jaxdet.stages import _compile
from jaxdet_kernels import cover, free_floor
_compile._MODULES = cover, free_floor
_compile.cores = lambda: 2
"""
_HELPED = '''
def load_module(module, device):
    """This process compiles nothing, and is as long at it as the other."""
    until = time.monotonic() + 60
    while time.monotonic() < until and not any(map(_compile._is_kept, _compile._MODULES)):
        time.sleep(0.05)


wp.load_module = load_module
_compile.compile_method()
'''
_STOPPED = """
from pathlib import Path


def load_module(module, device):
    # Stopped when the other process has begun to compile.
    while not list(Path(sys.argv[1]).glob("*_p*_t*/*.cpp")):
        time.sleep(0.01)
    raise KeyboardInterrupt


wp.load_module = load_module
try:
    _compile.compile_method()
except KeyboardInterrupt:
    pass
"""
_WAITS = """
import fcntl, threading
from pathlib import Path

seen = []


def load_module(module, device):
    seen.append(module.__name__)
    Path(sys.argv[1], wp.get_module(module.__name__).get_module_identifier(1)).mkdir(parents=True)
    Path(sys.argv[1], wp.get_module(module.__name__).get_module_identifier(1), "x.o").touch()


wp.load_module = load_module
_compile.cores = lambda: 1
with open(Path(sys.argv[1], ".compiling"), "w") as other:
    fcntl.flock(other, fcntl.LOCK_EX)
    waiting = threading.Thread(target=_compile.compile_method)
    waiting.start()
    time.sleep(0.3)
    assert waiting.is_alive() and not seen
    load_module(_compile._MODULES[0], "cpu")
waiting.join()
assert seen == [module.__name__ for module in _compile._MODULES], seen  # each of them once
"""
_UNSET = """
from jaxdet.stages import _compile
from jaxdet_kernels import cover
_compile._MODULES = (cover,)
_compile.compile_method()
"""
_KEPT = """
print(*(module.__name__ for module in _compile._MODULES if _compile._is_kept(module)))
"""


def kept(code: str, cache: Path) -> list[str]:
    """The modules in a cache after some code."""
    command = [sys.executable, "-c", _MODULES + code + _KEPT, str(cache)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


def test_another_process_compiles_what_this_one_looks_for(tmp_path: Path) -> None:
    """Both see the same name for the same code; the rest is compiled when it is called."""
    (module,) = kept(_HELPED, tmp_path)
    assert module.startswith("jaxdet_kernels.") and len(list(tmp_path.glob("*/*.o"))) == 1


def test_a_compilation_that_is_stopped_waits_for_nobody(tmp_path: Path) -> None:
    assert not kept(_STOPPED, tmp_path) and not list(tmp_path.glob("*/*.o"))


@pytest.mark.skipif(sys.platform == "win32", reason="needs fcntl")
def test_of_processes_that_start_together_one_compiles(tmp_path: Path) -> None:
    assert len(kept(_WAITS, tmp_path)) == 2


def test_where_no_cache_is_named_it_is_warps(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    named = {"WARP_CACHE_PATH": str(tmp_path / "warp"), "PYTHONPATH": os.pathsep.join(sys.path)}
    command, env = [sys.executable, "-c", _UNSET], {**os.environ, **named}
    subprocess.run(command, capture_output=True, check=True, cwd=tmp_path / "here", env=env)
    assert not list((tmp_path / "here").iterdir())
    assert list((tmp_path / "warp").rglob("*.o"))
