r"""The base class of data sets that process raw files once, and again after each change."""

import logging
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor
from torch_geometric.data import Dataset
from torch_geometric.data.dataset import files_exist

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile.data._fingerprint import (
    constructor_arguments,
    describe,
    setting_changes,
    state_changes,
    without_code,
)
from torch_geometric_tactile.data._processed_file import (
    OtherFormatError,
    ProcessedFile,
    read_processed,
    save_static,
)
from torch_geometric_tactile.data.apply_transform import apply_transform
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout

# Arguments of all data sets that do not change the processed file, or are described separately.
_OTHER_ARGS = ("root", "transform", "pre_transform", "pre_filter", "force_reload", "log", "layout")
_logger = logging.getLogger(__name__)
_MAX_LISTED_CHANGES = 3  # in a message


class ProcessedDataset(Dataset):
    r"""The base class of :class:`~torch_geometric_tactile.data.StaticDataset`: a PyG data set whose
    processed file records its settings.

    The settings are the class, the arguments of its constructor, :obj:`layout`,
    :obj:`pre_transform`, :obj:`pre_filter` and :meth:`raw_state`. If one of them has changed, a
    warning names it and the raw files are processed again. The same happens after an edit of the
    source code of a user's class, transform or filter, or of a module that this code imports.
    """

    layout: TaxelLayout
    force_reload: bool

    #: Arguments of the constructor that select from the processed samples. If they change, the raw
    #: files are not processed again.
    selection_args: Sequence[str] = ()

    _file: ProcessedFile | None = None
    _settings_cache: dict[str, str] | None = None

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        r"""Stores the arguments of the constructor, with which the processed file is compared."""
        self = super().__new__(cls)
        if args or kwargs:  # PyG copies a data set without arguments
            self.__dict__["_constructor_call"] = (args, kwargs)
        return self

    def read(self) -> Any:
        r"""Returns all samples. A subclass defines this method.

        The output is a :class:`~torch_geometric_tactile.data.StaticData`, or a list of PyG's
        :class:`~torch_geometric.data.Data` with the same edges. To name the numbers in :obj:`y`,
        :obj:`group` and :obj:`session`, return a tuple of the samples and a dictionary with the
        lists of names :obj:`"class"`, :obj:`"group"` and :obj:`"session"`.
        """
        raise NotImplementedError(
            f"'{type(self).__name__}' must define 'read', which returns StaticData or a list of "
            "Data, or a tuple of samples and a dictionary of names; for arrays or lists in memory, "
            "call StaticDataset.from_arrays or StaticDataset.from_data_list"
        )

    @property
    def raw_file_names(self) -> Any:
        r"""The names of the raw files. The default is all files in the folder :obj:`raw_dir`."""
        folder = Path(self.raw_dir)
        paths = folder.iterdir() if folder.is_dir() else ()
        return sorted(path.name for path in paths if path.is_file() and path.name[0] != ".")

    @property
    def processed_file_names(self) -> Any:
        r"""The name of the processed file. By default, the file is named after the class, such as
        :obj:`"my_grasps.pt"`.
        """
        return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", type(self).__name__).lower() + ".pt"

    def raw_state(self) -> list[str]:
        r"""Returns the state of the raw files as lines :obj:`"key=value"`, such as
        :obj:`"<name>=<size>,<time>"`. If a line has changed, the files are processed again.
        """
        return []

    def _settings(self) -> dict[str, str]:
        # The settings of the processed file as texts, described once since hashing is slow.
        if self._settings_cache is not None:
            return self._settings_cache
        cls = type(self)
        args, kwargs = self.__dict__.get("_constructor_call", ((), {}))
        arguments = constructor_arguments(cls, args, kwargs)
        ignored_args = {*_OTHER_ARGS, *self.selection_args}
        settings = {"class": describe(cls)}
        for key, value in arguments.items():
            if key not in ignored_args:
                settings[key] = describe(value)
        if hasattr(self, "layout") and "layout" not in self.selection_args:
            settings["layout"] = describe(self.layout)
        settings["pre_transform"] = describe(self.pre_transform)
        settings["pre_filter"] = describe(self.pre_filter)
        self._settings_cache = settings
        return settings

    @property
    def has_process(self) -> bool:
        r"""Whether there are files to process; :obj:`False` for a data set in memory."""
        return self.root != "???"  # PyG's placeholder for a missing root

    def _build(self) -> tuple[StaticData, dict[str, list[str]]]:
        data, names = self.__dict__.pop("_source", None) or self._read_samples()
        data, names = _with_unique_trials(data, names)
        if self.pre_filter is not None:
            indices = [i for i in range(data.num_samples) if self.pre_filter(data.sample(i))]
            need(indices, "'pre_filter' must keep at least one sample (kept none)")
            data = data.index_select(torch.tensor(indices))
        return apply_transform(self.pre_transform, data), names

    def _read_samples(self) -> tuple[StaticData, dict[str, list[str]]]:
        content = self.read()
        samples: Any = content
        names: Mapping[str, Sequence[str]] = {}
        if isinstance(content, tuple) and len(content) == 2 and isinstance(content[1], Mapping):
            samples, names = content
        if isinstance(samples, list | tuple):
            samples = StaticData.from_data_list(samples)
        if not isinstance(samples, StaticData):
            raise TypeError(
                f"'read' of '{type(self).__name__}' must return StaticData or a list of Data, or a "
                f"tuple of these and a dictionary of names (got {type(content).__name__})"
            )
        return samples, {key: list(values) for key, values in names.items()}

    def process(self) -> None:
        r"""Reads, filters and transforms the samples, and saves them. If processing is interrupted,
        no processed file is left.
        """
        # Recorded before reading, so that raw files that change meanwhile are processed again.
        settings, state = self._settings(), self.raw_state()
        data, names = self._build()
        save_static(data, names, self.processed_paths[0], settings, state)

    # PyG calls `_download` and `_process`. They are overridden because PyG only compares the `repr`
    # of the transforms and only warns about a difference.

    def _download(self) -> None:
        file, _ = self._load_current_file()
        if file is None:  # otherwise, the raw files are not needed
            super()._download()

    def _process(self) -> None:
        self._file, reason = self._load_current_file()
        if self._file is not None:
            return
        path = Path(self.processed_paths[0])
        if reason and not self._has_raw_files():
            hint = (
                " ('raw_file_names' is empty: leave it out of the class if 'read' needs no files)"
            )
            raise ValueError(
                f"processed file '{path}' cannot be used ({reason}), and the raw files to process "
                f"again are missing in '{self.raw_dir}'{'' if self.raw_paths else hint}"
            )
        if reason:
            _logger.warning("processing '%s' again: %s", path, reason)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.process()
        new_file = read_processed(path)
        differences = setting_changes(new_file.settings, self._settings())
        if differences:
            raise RuntimeError(
                f"another process has meanwhile written '{path}' with other settings "
                f"({short_list(differences, _MAX_LISTED_CHANGES)}); use a separate 'root' for each "
                "process"
            )
        self._file = new_file

    def _pop_file(self) -> tuple[StaticData, dict[str, list[str]]]:
        file, self._file = self._file, None
        if file is None:  # a subclass overrides `_process`
            file = read_processed(self.processed_paths[0])
        return file.data, file.names

    def _load_current_file(self) -> tuple[ProcessedFile | None, str]:
        # Returns the processed file if it is up to date. Otherwise, returns None, and the reason if
        # the file exists.
        path = Path(self.processed_paths[0])
        if self.force_reload or not path.is_file():
            return None, ""
        try:
            file = read_processed(path)
        except OtherFormatError:
            return None, "it was written by another version of torch_geometric_tactile"
        reasons = setting_changes(file.settings, self._settings())
        if self._has_raw_files():  # missing files have no state to compare
            reasons += state_changes(file.raw_state, self.raw_state())
        elif reasons and not setting_changes(
            without_code(file.settings), without_code(self._settings())
        ):
            # Only the user's source code differs. Without raw files, an error would make the
            # samples useless after the smallest edit.
            _logger.warning(
                "'%s' was processed by different code (%s) and cannot be processed again, since "
                "the raw files are missing in '%s': its samples are used unchanged",
                path,
                short_list(reasons, _MAX_LISTED_CHANGES),
                self.raw_dir,
            )
            reasons = []
        return (None, short_list(reasons, _MAX_LISTED_CHANGES)) if reasons else (file, "")

    def _has_raw_files(self) -> bool:
        if type(self).raw_file_names is _DEFAULT_RAW_FILE_NAMES:
            return True  # `read` checks for the files that it needs
        paths = self.raw_paths
        return len(paths) > 0 and files_exist(paths)


_DEFAULT_RAW_FILE_NAMES = ProcessedDataset.raw_file_names


def _with_unique_trials(data: Any, names: dict[str, list[str]]) -> tuple[Any, dict[str, list[str]]]:
    r"""Returns samples in which each trial has a unique number, and the names with the trial names
    in the new order.

    Equal numbers in different sessions are different trials. Equal numbers in different groups are
    different trials if the samples of the groups are not consecutive.
    """
    trial = _column(data, "trial")
    if trial is None or not len(trial):
        return data, names
    keys = [trial]
    session, group = _column(data, "session"), _column(data, "group")
    if session is not None:
        keys.append(session)
    if group is not None and _restarts_by_group(trial, group):
        keys.append(group)
    trial_keys, number = torch.stack(keys, dim=1).unique(dim=0, return_inverse=True)
    if len(trial_keys) == len(trial.unique()):
        return data, names
    _logger.info(
        "trial numbers restart in each %s: %d trials are now numbered from 0",
        "group" if len(keys) == 3 or session is None else "session",
        len(trial_keys),
    )
    data.trial = number.to(data["trial"].device)
    trial_names = names.get("trial", [])
    if trial_names:
        names = {**names, "trial": [trial_names[i] for i in trial_keys[:, 0].tolist()]}
    return data, names


def _column(data: Any, key: str) -> Tensor | None:
    value = data[key] if key in data else None  # noqa: SIM401 - Data is no mapping
    if not isinstance(value, Tensor) or value.dim() != 1 or value.is_floating_point():
        return None
    return value.long().cpu() if len(value) == data.num_samples else None


def _restarts_by_group(trial: Tensor, group: Tensor) -> bool:
    # Returns whether the samples of a trial number form several runs in different groups.
    changes = (trial[1:] != trial[:-1]).nonzero().view(-1) + 1
    first = torch.cat([torch.zeros(1, dtype=torch.long), changes])
    run_trial, run_group = trial[first], group[first]
    pairs = torch.stack([run_trial, run_group], dim=1).unique(dim=0)
    return len(pairs) > len(run_trial.unique())
