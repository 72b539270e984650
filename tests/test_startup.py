"""Caches of compiled programs between runs, in folders set by the environment."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import pytest

from jaxdet.cli import doctor
from jaxdet.cli.run import first_time
from jaxdet.engine.startup import (
    UNSAFE,
    Caches,
    cache_folders,
    is_writable,
    unsafe_caches,
    use_caches,
)

CODE = """
from jaxdet.engine import start_up
start_up()
import jax
import warp as wp

@wp.kernel
def kernel_of_this_test(a_out: wp.array(dtype=float)):
    a_out[wp.tid()] = 1.0

wp.launch(kernel_of_this_test, dim=3, inputs=[wp.zeros(3)])
print(jax.jit(lambda x: x * 3 + 1)(jax.numpy.arange(4)).tolist())
"""


@pytest.fixture
def no_caches(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("JAXDET_CACHE", "JAX_COMPILATION_CACHE_DIR", "WARP_CACHE_PATH", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, "")  # restored after the test
        monkeypatch.delenv(name)


def test_environment_variables_choose_the_folders(no_caches, monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    found = cache_folders()
    assert found.jax and found.jax.is_relative_to(tmp_path / ".cache" / "jaxdet")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert Path(str(cache_folders().warp)).is_relative_to(tmp_path / "xdg" / "jaxdet")
    monkeypatch.setenv("JAXDET_CACHE", str(tmp_path / "own"))
    found = cache_folders()
    assert found.jax and found.warp
    assert found.jax.parent.parent == found.warp.parent.parent == tmp_path / "own"
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path / "warp"))
    assert cache_folders() == Caches(found.jax, tmp_path / "warp")
    monkeypatch.setenv("JAXDET_CACHE", "off")
    assert cache_folders() == Caches(None, tmp_path / "warp")


def test_a_folder_that_cannot_be_created_is_not_used(no_caches, monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("JAXDET_CACHE", str(tmp_path / "file"))
    config: Any = jax.config
    before = config.jax_compilation_cache_dir
    assert use_caches() == Caches(None, None)
    assert config.jax_compilation_cache_dir == before


@pytest.mark.parametrize("mode", [0o777, 0o702])
def test_a_folder_that_others_can_write_to_is_not_used(no_caches, monkeypatch, tmp_path, mode):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setenv("JAXDET_CACHE", str(tmp_path / "shared"))
    private = cache_folders()
    assert private.jax and private.warp and unsafe_caches() == []
    private.jax.mkdir(parents=True)
    private.jax.chmod(mode)
    found = cache_folders()
    assert found.warp == private.warp
    assert found.jax and found.jax.is_relative_to(tmp_path / "xdg" / "jaxdet")
    assert unsafe_caches() == [private.jax]
    message = f"{private.jax} can be written to by other users"
    assert first_time(found).startswith(message) and str(found.jax) in first_time(found)
    assert doctor.caches() == (False, f"{private.jax} {UNSAFE}")
    found.jax.mkdir(parents=True, exist_ok=True)
    found.jax.chmod(mode)
    assert cache_folders() == Caches(None, private.warp)


def test_a_folder_of_another_user_is_not_used(no_caches, monkeypatch, tmp_path):
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path))
    assert cache_folders().warp == tmp_path
    monkeypatch.setenv("JAXDET_CACHE", str(tmp_path / "none"))
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    assert unsafe_caches() == [tmp_path]
    assert cache_folders().warp != tmp_path


def test_created_folders_are_private(no_caches, monkeypatch, tmp_path):
    monkeypatch.setenv("JAXDET_CACHE", str(tmp_path / "cache"))
    before = os.umask(0)
    try:
        assert is_writable(cache_folders().jax)
    finally:
        os.umask(before)
    assert unsafe_caches() == []


def start(cache: Path, script: Path) -> dict[Path, int]:
    """Start a process that compiles; return the cached files and their times."""
    script.write_text(CODE, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script)],
        env={**os.environ, "JAXDET_CACHE": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert (done.stdout, done.stderr) == ("[1, 4, 7, 10]\n", "")
    files = [path for path in cache.rglob("*") if path.is_file()]
    return {path: path.stat().st_mtime_ns for path in files if "jax-checksums" not in path.parts}


def test_a_second_start_compiles_only_what_is_damaged(no_caches, tmp_path):
    given = tmp_path / "cache", tmp_path / "script.py"
    first = start(*given)
    assert any("jax" in path.parts for path in first)
    assert any("kernel_of_this_test" in path.read_text() for path in first if path.suffix == ".cpp")
    assert start(*given) == first
    program = next(path for path in first if path.name.startswith("jit__lambda"))
    damaged = bytearray(program.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    program.write_bytes(damaged)
    start(*given)
    assert program.read_bytes() != bytes(damaged)
