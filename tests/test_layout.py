"""Structure of the repository: names of files, lazy imports, no addresses."""

import os
import re
import subprocess
import sys
from pathlib import Path

from jaxdet import config, reference, stages

ROOT = Path(__file__).resolve().parents[1]
STAGES = ("align", "ground", "features", "cluster", "footprint")
"""Stages of the published method."""
STEPS = ("cells", "floor", "surfaces", "obstacles", "outlines", "free")
"""Steps of the default on depth cells; each is a header of the kernels."""
BENCHMARKS = {*STAGES, *STEPS, "pipeline"} - {"ground"}
SECTIONS = ("ground", "features", "cluster", "footprint", "floor", "surface", "obstacle")
"""Sections of the configuration; the section of a step is the step's name in the singular."""
SIDES = ("reference", "stages")
EXPORTS = {"detect", "find_floors", "paper"}
HEAVY = ("cv2", "jax", "matplotlib", "mcap", "numba", "pyarrow", "warp")
SKIPPED_FOLDERS = {"__pycache__", "dist", "out"}


def named_files() -> list[str]:
    """Return the files of stages and steps, relative to the root."""
    twins = [f"jaxdet/reference/_{name}.py" for name in STEPS]
    twins += [f"kernels/jaxdet_kernels/include/jaxdet/{name}.h" for name in STEPS]
    twins += [f"jaxdet/{side}/paper/_{name}.py" for side in SIDES for name in STAGES]
    tests = [f"tests/test_{name}.py" for name in STAGES]
    tests += [f"tests/test_{name}_program.py" for name in STEPS]
    return twins + tests + [f"benchmarks/bench_{name}.py" for name in sorted(BENCHMARKS)]


def layout_faults(root: Path) -> list[str]:
    """Return violations of "one name everywhere" in the tree at ``root``."""
    faults = [f"{file} is missing" for file in named_files() if not (root / file).is_file()]
    wanted = {f"{name.capitalize()}Config" for name in SECTIONS}
    faults += [f"jaxdet/config.py lacks {name}" for name in sorted(wanted - set(dir(config)))]
    for package in (reference, stages):
        for module, wanted in ((package, EXPORTS), (package.paper, {"detect", *STAGES})):
            hidden = wanted - set(dir(module))
            faults += [f"{module.__name__} does not export {name}" for name in sorted(hidden)]
    timed = {path.stem.removeprefix("bench_") for path in root.glob("benchmarks/bench_*.py")}
    return faults + [f"bench_{name}.py is of no stage" for name in sorted(timed - BENCHMARKS)]


def tree(root: Path) -> list[Path]:
    """Return all files of the working tree except caches and outputs, without git."""
    files = []
    for folder, names, leaves in os.walk(root):
        hidden = {name for name in names if name.startswith(".") and name != ".ci"}
        names[:] = set(names) - hidden - SKIPPED_FOLDERS
        files += [Path(folder, leaf) for leaf in leaves]
    return sorted(files)


def test_each_stage_and_step_has_its_files_config_and_exports() -> None:
    assert layout_faults(ROOT) == []


def test_kernels_is_a_source_root_and_not_a_package() -> None:
    assert not (ROOT / "kernels/__init__.py").exists()
    assert (ROOT / "kernels/jaxdet_kernels/__init__.py").is_file()


def test_import_jaxdet_loads_nothing_heavy() -> None:
    code = f"import sys, jaxdet; print(*[m for m in {HEAVY} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


def test_no_file_names_a_machine_or_a_registry() -> None:
    hosts = [
        ("pypi", "org"),
        ("pythonhosted", "org"),
        ("crates", "io"),
        ("npmjs", "org"),
        ("anaconda", "org"),
    ]
    names = [r"\.".join(host) for host in hosts]
    folders = ["/".join(("", top, r"\w")) for top in ("root", "home", "Users", "work")]
    banned = re.compile("|".join([*names, *(r"(?<![\w.])" + f for f in folders)]).encode())
    found = {p: m.group() for p in tree(ROOT) if (m := banned.search(p.read_bytes()))}
    assert {str(path.relative_to(ROOT)): text for path, text in found.items()} == {}
