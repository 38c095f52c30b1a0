"""A plug-in of Dask workers that unpacks the files of a job and runs its tasks.

The scheduler also installs it on workers that join later.
"""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from distributed import WorkerPlugin, get_worker

from ... import __version__
from ...base import paths
from ...base.errors import SeroError
from ...study.engine import below
from .scenario_inputs import digest_of_code, digest_of_models, unpack

if TYPE_CHECKING:
    from ...study.engine import Job, Runner


def versions() -> dict[str, str]:
    """Returns a mapping from names of packages that affect results to versions."""
    return {"sero-mj": __version__, "mujoco": version("mujoco"), "numpy": version("numpy")}


class JobFiles(WorkerPlugin):  # type: ignore[misc]
    """A plug-in that stores a job and its files in a temporary folder of each worker."""

    def __init__(self, name: str, archive: bytes, job: Job, models: Mapping[str, str]) -> None:
        self.name, self._archive = name, archive
        self._job, self._models = job, dict(models)
        self._versions, self._code = versions(), digest_of_code()

    def setup(self, worker: Any) -> None:
        """Unpacks the files. Called by the worker."""
        os.environ["MUJOCO_GL"] = "disable"  # workers never render
        self._root = Path(worker.local_directory).absolute() / self.name
        self._kept = set(unpack(self._archive, self._root))
        self._archive = b""
        self._runner: Runner | None = None
        self._alone = threading.Lock()  # serializes `run`: its calls share cached models

    def teardown(self, worker: Any) -> None:
        shutil.rmtree(self._root, ignore_errors=True)

    def differences(self) -> list[str]:
        """Returns how this worker differs from the client in ways that would change results."""
        own = versions()
        found = [
            f"{name} is {own[name]} there and {wanted} here"
            for name, wanted in self._versions.items()
            if own[name] != wanted
        ]
        if not found and digest_of_code() != self._code:
            found.append(f"the code of sero-mj {__version__} differs")
        models = [paths.models_dir() / name for name in self._models]
        missing = [each for each in models if not each.is_file()]
        if not missing and digest_of_models(models) != self._models:
            missing = models
        if missing and not found:
            found.append(f"the included robot {missing[0].parent.name} differs")
        if not found:
            try:
                self._job.below(self._root).check()
            except SeroError as error:
                found.append(f"the scenario cannot be read: {self._without_root(str(error))}")
        return found

    def _without_root(self, text: str) -> str:
        return text.replace(str(self._root), "")

    def run(self, tasks: Sequence[Mapping[str, Any]], archive: bytes) -> list[dict[str, Any]]:
        """Runs tasks like `Runner.run`. `archive` contains files that only these tasks need."""
        with self._alone:
            if self._runner is None:
                self._runner = self._job.below(self._root).runner()
            own = [] if not archive else unpack(archive, self._root)
            try:
                results = self._runner.run([below(self._root, values) for values in tasks])
            finally:
                for file in set(own) - self._kept:
                    file.unlink(missing_ok=True)
        return [{**each, "error": self._without_root(each["error"])} for each in results]


def run_tasks(
    name: str, tasks: Sequence[Mapping[str, Any]], archive: bytes
) -> list[dict[str, Any]]:
    """Runs tasks with the `JobFiles` plug-in of this name. Called on a worker."""
    found: list[dict[str, Any]] = get_worker().plugins[name].run(tasks, archive)
    return found


def differences_on_worker(name: str, dask_worker: Any) -> list[str]:
    """Returns `JobFiles.differences` of the plug-in of this name. Called on a worker."""
    found: list[str] = dask_worker.plugins[name].differences()
    return found
