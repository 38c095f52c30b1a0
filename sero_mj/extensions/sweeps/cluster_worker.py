"""What a worker of a Dask cluster does: it unpacks the files of a job, and does its tasks.

A plug-in of the worker, which the scheduler also gives to workers that join later.
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
from ...study.shipped_files import below
from .scenario_inputs import digest_of_code, digest_of_models, unpack

if TYPE_CHECKING:
    from ...study.engine import Job, Runner


def versions() -> dict[str, str]:
    """What results depend on that is installed, by name."""
    return {"sero-mj": __version__, "mujoco": version("mujoco"), "numpy": version("numpy")}


class JobFiles(WorkerPlugin):  # type: ignore[misc]
    """A job and its files on a worker, in a folder of their own until it has ended."""

    def __init__(self, name: str, archive: bytes, job: Job, models: Mapping[str, str]) -> None:
        self.name, self._archive = name, archive
        self._job, self._models = job, dict(models)
        self._versions, self._code = versions(), digest_of_code()

    def setup(self, worker: Any) -> None:
        """Unpacks the files; called by the worker, as is `teardown`."""
        os.environ["MUJOCO_GL"] = "disable"  # no rendering here
        self._root = Path(worker.local_directory).absolute() / self.name
        self._kept = set(unpack(self._archive, self._root))
        self._archive = b""
        self._runner: Runner | None = None
        self._alone = threading.Lock()  # a runner keeps models that it has compiled

    def teardown(self, worker: Any) -> None:
        """Removes the files."""
        shutil.rmtree(self._root, ignore_errors=True)

    def differences(self) -> list[str]:
        """What is not here as it is where the work was begun; empty if its results will be."""
        own = versions()
        found = [
            f"{name} is {own[name]}, and {wanted} here"
            for name, wanted in self._versions.items()
            if own[name] != wanted
        ]
        if not found and digest_of_code() != self._code:
            found.append(f"sero-mj {__version__} is other code than here")
        models = [paths.models_dir() / name for name in self._models]
        missing = [each for each in models if not each.is_file()]
        if not missing and digest_of_models(models) != self._models:
            missing = models
        if missing and not found:
            found.append(f"the shipped robot {missing[0].parent.name} is another one than here")
        if not found:
            try:
                self._job.below(self._root).check()
            except SeroError as error:
                found.append(f"the scenario cannot be read: {self._told(str(error))}")
        return found

    def _told(self, text: str) -> str:
        return text.replace(str(self._root), "")

    def run(self, tasks: Sequence[Mapping[str, Any]], archive: bytes) -> list[dict[str, Any]]:
        """Does tasks together, see `Runner.run`; the archive has the files of these alone."""
        with self._alone:
            if self._runner is None:
                self._runner = self._job.below(self._root).runner()
            own = [] if not archive else unpack(archive, self._root)
            try:
                results = self._runner.run([below(self._root, values) for values in tasks])
            finally:
                for file in set(own) - self._kept:
                    file.unlink(missing_ok=True)
        return [{**each, "error": self._told(each["error"])} for each in results]


def run_tasks(
    name: str, tasks: Sequence[Mapping[str, Any]], archive: bytes
) -> list[dict[str, Any]]:
    """Does tasks by the plug-in of this name."""
    found: list[dict[str, Any]] = get_worker().plugins[name].run(tasks, archive)
    return found


def differences_on_worker(name: str, dask_worker: Any) -> list[str]:
    """What differs on a worker, by the plug-in of this name."""
    found: list[str] = dask_worker.plugins[name].differences()
    return found
