"""The house rules that a machine can check: names, lazy imports, no addresses."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STAGES = ("align", "ground", "features", "cluster", "footprint")
STAGES_WITH_KERNELS = ("align", "features")
STAGES_WITH_CONFIG = STAGES[1:]
HEAVY = ("cv2", "jax", "matplotlib", "mcap", "numba", "pyarrow", "warp")
SKIPPED_FOLDERS = {"__pycache__", "dist", "out"}


def stage_files(stage: str) -> list[str]:
    """The files that a stage consists of, relative to the root."""
    files = [
        f"jaxdet/reference/_{stage}.py",
        f"jaxdet/stages/_{stage}.py",
        f"tests/test_{stage}.py",
        f"benchmarks/bench_{stage}.py",
    ]
    if stage in STAGES_WITH_KERNELS:
        files.append(f"kernels/jaxdet_kernels/{stage}.py")
    return files


def exported(package: Path) -> set[str]:
    """The names that a package's ``__init__.py`` imports, read without importing it."""
    init = package / "__init__.py"
    module = ast.parse(init.read_text(encoding="utf-8") if init.is_file() else "")
    imports = [node for node in ast.walk(module) if isinstance(node, ast.ImportFrom)]
    return {alias.asname or alias.name for node in imports for alias in node.names}


def layout_faults(root: Path) -> list[str]:
    """What breaks "one name for a stage everywhere" in the tree at ``root``."""
    faults = []
    config = ast.parse((root / "jaxdet/config.py").read_text(encoding="utf-8"))
    classes = {node.name for node in config.body if isinstance(node, ast.ClassDef)}
    for stage in STAGES:
        faults += [
            f"{file} is missing" for file in stage_files(stage) if not (root / file).is_file()
        ]
        if stage in STAGES_WITH_CONFIG and f"{stage.capitalize()}Config" not in classes:
            faults.append(f"jaxdet/config.py lacks {stage.capitalize()}Config")
    for package in ("reference", "stages"):
        hidden = set(STAGES) - exported(root / "jaxdet" / package)
        faults += [f"jaxdet.{package} does not export {stage}" for stage in sorted(hidden)]
    return faults


def tree(root: Path) -> list[Path]:
    """Every file of the working tree but caches and outputs; needs no git."""
    files = []
    for folder, names, leaves in os.walk(root):
        hidden = {name for name in names if name.startswith(".") and name != ".ci"}
        names[:] = set(names) - hidden - SKIPPED_FOLDERS
        files += [Path(folder, leaf) for leaf in leaves]
    return sorted(files)


def test_each_stage_has_its_files_config_and_exports() -> None:
    assert layout_faults(ROOT) == []


def test_a_missing_stage_file_is_found(tmp_path: Path) -> None:
    for top in ("jaxdet", "kernels", "tests", "benchmarks"):
        skip = shutil.ignore_patterns("__pycache__", "goldens")
        shutil.copytree(ROOT / top, tmp_path / top, ignore=skip)
    for lost in [file for stage in STAGES for file in stage_files(stage)]:
        (tmp_path / lost).rename(tmp_path / "lost")
        assert layout_faults(tmp_path) == [f"{lost} is missing"]
        (tmp_path / "lost").rename(tmp_path / lost)


def test_kernels_is_a_source_root() -> None:
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
