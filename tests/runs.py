"""Runs of logs for tests."""

from pathlib import Path
from typing import Any

from jaxdet import engine
from jaxdet.config import Config


def run_logs(logs: Any, output: Path, config: Config | None = None, **options: Any) -> Any:
    """Run logs with arguments of :meth:`jaxdet.Runner.run`; return the summary."""
    with engine.Runner(backend=options.get("backend", "jax")) as runner:
        return runner.run(logs, output, config or Config(), **options)


def only_log(results: Path) -> Path:
    """Return the folder of the only log of results."""
    (folder,) = (path for path in results.iterdir() if path.is_dir() and path.name != ".jaxdet")
    return folder


def run_log(path: Any, output: Path, config: Config | None = None, **options: Any) -> Any:
    """Run one log; ``output`` becomes the folder of its results, not of all results."""
    output.parent.mkdir(parents=True, exist_ok=True)
    around = output.with_name(f"{output.name}.run")
    summary = run_logs(path, around, config, **options)
    only_log(around).rename(output)
    return summary
