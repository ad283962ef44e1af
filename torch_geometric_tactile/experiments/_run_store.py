r"""Stores finished runs in files."""

import hashlib
import json
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path, remove_leftovers
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.experiments._experiment import Experiment

_KEYS_WITHOUT_CHECKSUM = {"experiment", "finished", "identity", "result"}


class RunStore:
    r"""The finished runs in a folder, with one JSON file per run. Files are written atomically.

    Args:
        folder (str or PathLike): The folder, which may not exist yet.
    """

    def __init__(self, folder: PathLike) -> None:
        self.folder = Path(folder)
        # The code at the end of a file name identifies the experiment, regardless of its name.
        self._paths = {path.stem.rpartition("_")[2]: path for path in self.folder.glob("*.json")}

    def path(self, experiment: Experiment) -> Path:
        r"""Returns the path of the file of a run, which may not exist yet."""
        return self._paths.get(experiment.code, self.folder / experiment.file_name)

    def read(self, experiment: Experiment) -> dict[str, Any] | None:
        r"""Returns the result of a run, or :obj:`None` if it is not finished.

        Raises:
            ValueError: If the file is damaged or belongs to another experiment.
        """
        path = self.path(experiment)
        if not path.is_file():
            return None
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            result: dict[str, Any] = content["result"]
            # Runs of earlier versions have no checksum, and exactly these keys.
            if content.keys() != _KEYS_WITHOUT_CHECKSUM and content["sha256"] != _sha256(result):
                raise ValueError("its result differs from its checksum")
            is_same = content["identity"] == experiment.identity()
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise ValueError(f"'{path}' is damaged: delete it to run it again ({error})") from error
        need(is_same, f"'{path}' belongs to another experiment: delete it to run this one")
        return result

    def write(self, experiment: Experiment, result: dict[str, Any]) -> None:
        r"""Writes the file of a finished run, atomically."""
        content = {
            "experiment": experiment.name,
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            "identity": experiment.identity(),
            "result": result,
            "sha256": _sha256(json.loads(json.dumps(result))),
        }
        with atomic_path(self.folder / experiment.file_name) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")

    def clean(self, experiments: Sequence[Experiment]) -> None:
        r"""Removes temporary files of killed processes, but not of running ones."""
        for experiment in experiments:
            remove_leftovers(self.folder / experiment.file_name)


def _sha256(result: Any) -> str:
    # The checksum of the content. It does not depend on indentation or the order of keys.
    return hashlib.sha256(json.dumps(result, sort_keys=True).encode()).hexdigest()
