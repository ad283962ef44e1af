r"""Processing raw files once, and again when something has changed."""

import logging
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import torch
from torch_geometric.data import Dataset
from torch_geometric.data.dataset import files_exist

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile.data._fingerprint import (
    changes,
    constructor_arguments,
    describe,
    state_changes,
    without_code,
)
from torch_geometric_tactile.data._processed_file import (
    OtherFormatError,
    ProcessedFile,
    read_processed,
    save_static,
)
from torch_geometric_tactile.data._trial_numbers import with_own_numbers
from torch_geometric_tactile.data.apply_transform import apply_transform
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout

# Arguments of any data set that do not change the processed file, or are described apart.
_OTHER_ARGS = ("root", "transform", "pre_transform", "pre_filter", "force_reload", "log", "layout")
_logger = logging.getLogger(__name__)
_NUM_CHANGES = 3  # that a message names


class ProcessedDataset(Dataset):
    r"""A PyG data set with a processed file that records what it was made with: the class, the
    arguments of its constructor, :obj:`layout`, :obj:`pre_transform`, :obj:`pre_filter` and
    :meth:`raw_state`. If one of them differs, the raw files are processed again, and a warning is
    logged that names it. So they are if the source code of the user's own class, transform or
    filter, or of a module that it imports, was edited.

    It is the base of :class:`~torch_geometric_tactile.data.StaticDataset`.
    """

    layout: TaxelLayout
    force_reload: bool

    #: Arguments of the constructor that choose from the processed samples: if they change, nothing
    #: has to be processed again. An argument of one name in several classes is one.
    selection_args: Sequence[str] = ()

    _file: ProcessedFile | None = None
    _described: dict[str, str] | None = None

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        r"""Keeps the arguments until the processed file was compared with them."""
        self = super().__new__(cls)
        if args or kwargs:  # neither is given where PyG copies a data set
            self.__dict__["_given"] = (args, kwargs)
        return self

    def read(self) -> Any:
        r"""Returns all samples: :class:`~torch_geometric_tactile.data.StaticData`, or a list of
        PyG's :class:`~torch_geometric.data.Data` with the same edges. With names, it returns a
        tuple of the samples and a dictionary: the names of :obj:`y` (:obj:`"class"`),
        :obj:`group` (:obj:`"group"`) and :obj:`session` (:obj:`"session"`), each a list.
        """
        raise NotImplementedError(
            f"'{type(self).__name__}' must define 'read', which returns StaticData or a list of "
            "Data, or a tuple of these and a dictionary of names; for arrays or lists in memory, "
            "call StaticDataset.from_arrays or StaticDataset.from_data_list"
        )

    @property
    def raw_file_names(self) -> Any:
        r"""The raw files, by default all in the folder :obj:`raw_dir`, which may be none."""
        folder = Path(self.raw_dir)
        paths = folder.iterdir() if folder.is_dir() else ()
        return sorted(path.name for path in paths if path.is_file() and path.name[0] != ".")

    @property
    def processed_file_names(self) -> Any:
        r"""The processed file, by default named after the class: :obj:`"my_grasps.pt"`."""
        return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", type(self).__name__).lower() + ".pt"

    def raw_state(self) -> list[str]:
        r"""Returns the state of the raw files as lines :obj:`"key=value"`, such as
        :obj:`"<name>=<size>,<time>"`. If a line differs, the files are processed again.
        """
        return []

    def _settings(self) -> dict[str, str]:
        # What the processed file is made with, as text by name.
        if self._described is not None:
            return self._described
        kind = type(self)
        args, kwargs = self.__dict__.get("_given", ((), {}))
        arguments = constructor_arguments(kind, args, kwargs)
        skipped = {*_OTHER_ARGS, *self.selection_args}
        settings = {"class": describe(kind)}
        for key, value in arguments.items():
            if key not in skipped:
                settings[key] = describe(value)
        if hasattr(self, "layout") and "layout" not in self.selection_args:
            settings["layout"] = describe(self.layout)
        settings["pre_transform"] = describe(self.pre_transform)
        settings["pre_filter"] = describe(self.pre_filter)
        self._described = settings
        return settings

    @property
    def has_process(self) -> bool:
        r"""Whether there are files to process: not so in memory."""
        return self.root != "???"  # PyG's mark of a missing root

    def _build(self) -> tuple[StaticData, dict[str, list[str]]]:
        data, names = self.__dict__.pop("_source", None) or self._read_samples()
        data, names = with_own_numbers(data, names)
        if self.pre_filter is not None:
            kept = [i for i in range(data.num_samples) if self.pre_filter(data.sample(i))]
            need(kept, "'pre_filter' must keep at least one sample (kept none)")
            data = data.index_select(torch.tensor(kept))
        return apply_transform(self.pre_transform, data), names

    def _read_samples(self) -> tuple[StaticData, dict[str, list[str]]]:
        result = self.read()
        samples: Any = result
        names: Mapping[str, Sequence[str]] = {}
        if isinstance(result, tuple) and len(result) == 2 and isinstance(result[1], Mapping):
            samples, names = result
        if isinstance(samples, list | tuple):
            samples = StaticData.from_data_list(samples)
        if not isinstance(samples, StaticData):
            raise TypeError(
                f"'read' of '{type(self).__name__}' must return StaticData or a list of Data, or a "
                f"tuple of these and a dictionary of names (got {type(result).__name__})"
            )
        return samples, {key: list(values) for key, values in names.items()}

    def process(self) -> None:
        r"""Reads, filters and transforms the samples, and saves them whole or not at all."""
        # Before reading: a file that changes from here on is processed again the next time.
        settings, state = self._settings(), self.raw_state()
        data, names = self._build()
        save_static(data, names, self.processed_paths[0], settings, state)

    # PyG calls the next two; its own `_process` compares the `repr` of the transforms only.

    def _download(self) -> None:
        file, _ = self._compared()
        if file is None:  # otherwise the raw files are not needed
            super()._download()

    def _process(self) -> None:
        self._file, why = self._compared()
        if self._file is not None:
            return
        path = Path(self.processed_paths[0])
        if why and not self._has_raw():
            hint = (
                " ('raw_file_names' is empty: leave it out of the class if 'read' needs no files)"
            )
            raise ValueError(
                f"processed file '{path}' cannot be used ({why}) and the raw files to process "
                f"again are missing in '{self.raw_dir}'{'' if self.raw_paths else hint}"
            )
        if why:
            _logger.warning("processing '%s' again: %s", path, why)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.process()
        written = read_processed(path)
        other = changes(written.settings, self._settings())
        if other:
            raise RuntimeError(
                f"another process has written '{path}' meanwhile, with other settings "
                f"({short_list(other, _NUM_CHANGES)}); give each a 'root' of its own"
            )
        self._file = written

    def _take_file(self) -> tuple[StaticData, dict[str, list[str]]]:
        file, self._file = self._file, None
        if file is None:  # a subclass has processed in its own way
            file = read_processed(self.processed_paths[0])
        return file.data, file.names

    def _compared(self) -> tuple[ProcessedFile | None, str]:
        # The processed file, if it is there and up to date; or else why it is not.
        path = Path(self.processed_paths[0])
        if self.force_reload or not path.is_file():
            return None, ""
        try:
            file = read_processed(path)
        except OtherFormatError:
            return None, "it is not of this version of torch_geometric_tactile"
        why = changes(file.settings, self._settings())
        if self._has_raw():  # what is missing has not changed
            why += state_changes(file.raw_state, self.raw_state())
        elif why and not changes(without_code(file.settings), without_code(self._settings())):
            _logger.warning(
                "'%s' was made by other code (%s) and cannot be made again, since the raw files "
                "are missing in '%s': its samples are used as they are",
                path,
                short_list(why, _NUM_CHANGES),
                self.raw_dir,
            )
            why = []
        return (None, short_list(why, _NUM_CHANGES)) if why else (file, "")

    def _has_raw(self) -> bool:
        if type(self).raw_file_names is _FOLDER_FILES:
            return True  # `read` asks for its files
        paths = self.raw_paths
        return len(paths) > 0 and files_exist(paths)


_FOLDER_FILES = ProcessedDataset.raw_file_names
