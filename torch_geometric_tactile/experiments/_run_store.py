r"""Finished runs, kept on disk."""

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

_KEYS = {"experiment", "finished", "identity", "result"}


class RunStore:
    r"""The finished runs of a folder, one JSON file each, whole or absent."""

    def __init__(self, folder: PathLike) -> None:
        self.folder = Path(folder)
        self._paths = {path.stem.rpartition("_")[2]: path for path in self.folder.glob("*.json")}

    def path(self, experiment: Experiment) -> Path:
        r"""Returns where a run is or would be."""
        return self._paths.get(experiment.code, self.folder / experiment.file_name)

    def read(self, experiment: Experiment) -> dict[str, Any] | None:
        r"""Returns the result of a run, or :obj:`None` if it is not finished."""
        path = self.path(experiment)
        if not path.is_file():
            return None
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            result: dict[str, Any] = content["result"]
            # Runs of earlier versions have no checksum, and exactly these keys.
            if content.keys() != _KEYS and content["sha256"] != _sha256(result):
                raise ValueError("its result differs from its checksum")
            same = content["identity"] == experiment.identity()
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise ValueError(f"'{path}' is damaged: delete it to run it again ({error})") from error
        need(same, f"'{path}' is not what its name says: delete it to run it again")
        return result

    def write(self, experiment: Experiment, result: dict[str, Any]) -> None:
        r"""Writes the result of a run, whole or not at all."""
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
        r"""Removes what killed runs had begun to write, and nothing of a run that is alive."""
        for experiment in experiments:
            remove_leftovers(self.folder / experiment.file_name)


def _sha256(result: Any) -> str:
    # Of what the file holds, whatever its lines and spaces are.
    return hashlib.sha256(json.dumps(result, sort_keys=True).encode()).hexdigest()
