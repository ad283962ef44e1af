r"""A data set of the frames of recordings, for any sensor."""

import logging
import re
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import FrameInfo, Protocol, Recording, StaticData
from torch_geometric_tactile.data._sample_units import TRIAL_PREFIX
from torch_geometric_tactile.data.recording import UNITS
from torch_geometric_tactile.datasets._frame_labels import ObjectLabels, frame_labels
from torch_geometric_tactile.datasets._frame_reader import (
    FrameReader,
    UnreadRecording,
    raise_all,
)
from torch_geometric_tactile.datasets._splits import checked_split
from torch_geometric_tactile.datasets._trial import DEFAULT_PATTERN, Trial, checked_pattern
from torch_geometric_tactile.datasets._trial_frames import (
    PARTS,
    TrialFrames,
    check_frame_selection,
)
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.io.recording_files import select_format
from torch_geometric_tactile.sensors import TaxelLayout, as_layout

# Arguments, including those of subclasses, that select from the processed frames.
_SELECTION_ARGS = (
    "split",
    "protocol",
    "split_by",
    "fractions",
    "split_seed",
    "fold",
    "phases",
    "stride",
    "rate",
    "samples_per_trial",
    "sample_seed",
    "tare",
)
_MAX_BYTES_TO_LIST_ALL_ERRORS = 200_000_000  # read in less than a minute
_MAX_LISTED_FILES = 3  # in a message
_logger = logging.getLogger(__name__)


class RecordingFrames(TrialFrames):
    r"""A data set of the frames of recordings, from a folder or in memory. A sample is a frame. The
    layout, the number of channels and the number of joints (or none) are arbitrary.

    Each file in :obj:`root/raw` or :obj:`root` is one trial, in a format of
    :func:`~torch_geometric_tactile.io.read_recording`: ``.h5``, ``.hdf5``, ``.npz``, ``.mcap`` or
    ``.csv``. A sample has these attributes:

    * :obj:`x`, :obj:`y`, :obj:`trial` (the file) and :obj:`time` in seconds;
    * if they are known for all files: :obj:`joint`, :obj:`action`, :obj:`group` (the object),
      :obj:`session`, :obj:`placement` (of the hand), :obj:`size` (of the object) and
      :obj:`property`;
    * :obj:`phase`, which is -1 in files without phases;
    * the shared :obj:`pos` and :obj:`normal` of the layout, if it has one link. On a hand, they
      depend on the joint angles; :class:`~torch_geometric_tactile.transforms.TaxelPose` computes
      them.

    Missing readings stay NaN.

    The object, the trial number and other metadata are read from the metadata of a recording or
    from its file name: with the default :obj:`pattern`, ``mug_003.csv`` is trial 3 of the object
    ``mug``. Two CSV files beside the recordings or in :obj:`root` can supply further metadata:
    ``annotations.csv`` has the columns ``recording``, ``start``, ``end`` and ``label``;
    ``labels.csv`` has ``recording``, ``label`` and further columns. The tables must not contradict
    the recordings.

    All files are processed once, and again when a file is added, removed or changed.
    :obj:`split`, :obj:`phases` and :obj:`stride` select from the memory-mapped processed file
    without copying the readings.

    Args:
        root (str or PathLike, optional): Folder of the data set.
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of a layout of the
            package, or a layout file.
        recordings (sequence of Recording, optional): Recordings in memory, in place of
            :obj:`root`.
        target (str): The label :obj:`y`:

            * :obj:`"object"`: an index into :obj:`group_names`.
            * :obj:`"property"`: 0 or 1 for each of the :obj:`"label_names"` in the metadata, as
              given in :obj:`"labels"`.
            * :obj:`"label"`: the label of the recording.
            * :obj:`"annotation"`: the label of the annotation that covers a frame, or
              :obj:`"none"`.
            * Any other key is looked up frame by frame in :obj:`privileged`, where
              :func:`~torch_geometric_tactile.io.read_recording` stores label columns, then in the
              metadata and the groups of :obj:`pattern`.
        split (str, optional): :obj:`"train"`, :obj:`"val"`, :obj:`"test"`, or :obj:`None` for all
            frames.
        protocol (Protocol, optional): The split. By default, complete trials are held out,
            stratified by class if each class has enough trials.
        split_seed (int): Seed of the random split. The split of a frame does not depend on
            :obj:`phases`, :obj:`stride`, :obj:`rate` or :obj:`samples_per_trial`.
        fold (int): Index of the test fold, for a protocol with folds.
        adjacency (str, optional): Name of an adjacency of the layout, whose edges are used. The
            default is :obj:`"original"`, or the only adjacency. If the layout has no edges, use a
            :obj:`pre_transform` such as :class:`~torch_geometric_tactile.transforms.KNNGraph`.
        phases (sequence of str, optional): Selects the frames in these phases, from
            :obj:`privileged["phase"]` and :obj:`meta["phase_names"]`.
        stride (int): Selects every :obj:`stride`-th frame of each trial.
        rate (float, optional): Rate in hertz at which frames are selected: the frames nearest in
            time to the ticks of a clock that starts with the first frame of each trial.
        samples_per_trial (int, optional): Number of frames of each trial, drawn at random after the
            selections above. The draw depends only on :obj:`sample_seed` and the name of the trial.
        sample_seed (int): Seed of :obj:`samples_per_trial`.
        pattern (str): Regular expression that matches the full name of a file without its suffix.
            Its named groups, such as :obj:`object`, :obj:`trial`, :obj:`session`, :obj:`label` and
            :obj:`person`, become metadata of the recording, and units of
            :class:`~torch_geometric_tactile.data.Protocol`. Names in braces are a short form:
            :obj:`"{person}_{object}_{trial}"`, where a trial is a number. If the pattern contains a
            :obj:`"/"`, files in subfolders are read as well, and names begin with their folders.
        read_options (Mapping, optional): Options of
            :func:`~torch_geometric_tactile.io.read_recording`, such as the names of columns. If
            expressions select the columns, all files use the column order of the first file.
        unit (str, optional): Unit of recordings that name no unit in their metadata:
            :obj:`"count"`, :obj:`"newton"` or :obj:`"microtesla"`. If left out, either all
            recordings or none must name a unit.
        resample (float, optional): Rate in hertz to which all recordings are resampled first by
            :meth:`Recording.resample <torch_geometric_tactile.data.Recording.resample>`. Required
            for windows of recordings with different rates.
        tare (float or str, optional): The frames at rest: the name of a phase, such as
            :obj:`"hover"`, or the number of seconds at the start of each trial. Their mean reading
            is subtracted from all frames of the same trial before :obj:`transform`. Frames at rest
            are used even if they are not selected.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.

    Raises:
        FileNotFoundError: If there are no recordings.
        ValueError: If

            * an argument is unknown or leaves no sample,
            * a recording cannot be read, does not fit the layout, or differs from the others in its
              channels, joints or unit,
            * the target of a recording is unknown,
            * two recordings hold the same trial, or different properties of the same object,
            * a table names a missing file or contradicts a recording, or
            * annotations with different labels overlap on a frame and the target is
              :obj:`"annotation"`.

    Examples:
        >>> import numpy as np
        >>> from torch_geometric_tactile.sensors import grid
        >>> grasps = [
        ...     Recording(time=[0.0, 0.1], tactile=np.zeros((2, 6, 1)), label=label)
        ...     for label in ("slip", "hold", "slip")
        ... ]
        >>> dataset = RecordingFrames(
        ...     layout=grid(2, 3, 0.01), recordings=grasps, target="label"
        ... )
        >>> dataset, dataset.class_names, dataset.data.y.tolist()
        (RecordingFrames(6), ['hold', 'slip'], [1, 1, 0, 0, 1, 1])
    """

    num_channels: int | None = None  # per taxel; None allows any number
    num_joints: int | None = None
    _stored: tuple[str, ...] = ("object", "property")  # targets that every processed file holds
    _needs: tuple[str, ...] = ()  # "object" and "trial", if every recording must have them
    _labels = ObjectLabels()
    _other_target = "target='label' or target='property'"
    _processed_name = "recording_frames.pt"

    def __init__(
        self,
        root: PathLike | None = None,
        layout: TaxelLayout | PathLike | None = None,
        *,
        recordings: Sequence[Recording] | None = None,
        target: str = "object",
        split: Literal["train", "val", "test"] | None = None,
        protocol: Protocol | None = None,
        split_seed: int = 0,
        fold: int = 0,
        adjacency: str | None = None,
        phases: Sequence[str] | None = None,
        stride: int = 1,
        rate: float | None = None,
        samples_per_trial: int | None = None,
        sample_seed: int = 0,
        tare: float | str | None = None,
        pattern: str = DEFAULT_PATTERN,
        read_options: Mapping[str, Any] | None = None,
        unit: Literal["count", "newton", "microtesla"] | None = None,
        resample: float | None = None,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        _check_arguments(root, recordings, stride=stride, unit=unit)
        check_frame_selection(rate, samples_per_trial, sample_seed)
        if resample is not None:
            FrameInfo(rate=resample, resampled=True)  # raises an error for an invalid rate
        if layout is None:
            raise ValueError("'layout' must name the taxel layout of the recordings (got None)")
        self.layout = as_layout(layout)
        adjacency = self.layout.default_adjacency if adjacency is None else adjacency
        self.target = target
        self.split = checked_split(split, PARTS)
        self.protocol = Protocol("trial", stratify="auto") if protocol is None else protocol
        self.split_seed = split_seed
        self.fold = fold
        self.adjacency = adjacency
        self.phases = (phases,) if isinstance(phases, str) else phases and tuple(phases)
        self.stride = stride
        self.rate = rate
        self.samples_per_trial = samples_per_trial
        self.sample_seed = sample_seed
        self.tare = tare
        self.pattern = checked_pattern(pattern)
        self.read_options = dict(read_options or {})
        self.unit = unit
        self.resample = resample
        self._recordings: list[Recording] | None = None if recordings is None else list(recordings)
        edge_index = None if adjacency is None else self.layout.edge_index(adjacency).clone()
        self.pre_transform, self.pre_filter = pre_transform, pre_filter
        self.selection_args = (*_SELECTION_ARGS, *self._set_after_loading())
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)
        self._recordings = None
        if not self._is_filtered:
            self._data.edge_index = edge_index
            self._clone_shared()
            self._data.y = self._labels.target(self._data, self._names, target, str(self.root))
        _warn_of_one_object(self)
        self.group_kind = "object" if f"{TRIAL_PREFIX}object" in self._names else "group"
        self._tare()
        self._select()

    @property
    def processed_dir(self) -> str:
        r"""The folder of the processed file. With a :obj:`pre_transform` or :obj:`pre_filter`, each
        target and adjacency has a separate folder.
        """
        folder = Path(self.root, "processed")
        subfolder = f"{self.target}_{self.adjacency}"
        return str(folder / subfolder if self._is_filtered else folder)

    @property
    def _is_filtered(self) -> bool:
        return self.pre_transform is not None or self.pre_filter is not None

    def _set_after_loading(self) -> tuple[str, ...]:
        # Returns the arguments that do not change the processed file: edges and stored targets,
        # unless a filter or transform uses them. With several links, the layout is not stored
        # either, since there are no positions.
        if self._is_filtered:
            return ()
        target = ("target", "task") if self.target in self._stored else ()
        layout = ("layout",) if len(self.layout.link_names) > 1 else ()
        return ("adjacency", *target, *layout)

    def read_trial(self, path: PathLike) -> Recording:
        r"""Reads the recording in a file. A subclass can override this method to read another
        format.

        Args:
            path (str or PathLike): The file.
        """
        recording = read_recording(path, **self.read_options)
        column = self.read_options.get("label")
        if self.target != column or column == "label" or recording.label is None:
            return recording
        # A label column with the same text in all frames is read as the label of the recording.
        # The column is restored, so that such files also have the target frame by frame.
        labels = np.full(recording.num_frames, recording.label)
        return replace(recording, privileged={**recording.privileged, self.target: labels})

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all trials."""
        needs = {*self._needs, *(["object"] if self.target == "object" else [])}
        reader = FrameReader(
            self.layout, self.pattern, tuple(needs), self.num_channels, self.num_joints, self.unit
        )
        folder, errors = None, {}
        if self._recordings is None:
            folder, unread = Path(self.processed_dir), self._trials_to_read()
            errors = self._first_frame_errors(reader)
        else:
            unread = [
                UnreadRecording(f"recording {i}", str(i), partial(copy, recording))
                for i, recording in enumerate(self._recordings)
            ]
        x, trials = reader.read([*map(self._resampled, unread)], folder, errors)
        target = None if self.target in self._stored else self.target
        names, labels = frame_labels(trials, self._labels, target)
        for trial in reversed(trials):  # the first trial that names its columns overrides the rest
            names |= {f"{key}_columns": columns for key, columns in trial.columns.items()}
        unit = trials[0].meta.get("unit", self.unit)
        names["unit"] = [] if unit is None else [unit]
        data = StaticData(x=x, **labels)
        if self.adjacency is not None:
            data.edge_index = self.layout.edge_index(self.adjacency)
        _warn_of_names(trials, self.pattern)
        if len(self.layout.link_names) == 1:
            data.pos, data.normal = self.layout.pos, self.layout.normal
        for key, value in self._labels.extra_attributes(trials, names).items():
            data[key] = value
        data.y = self._labels.target(data, names, self.target, str(self.root))
        return data, names

    def _first_frame_errors(self, reader: FrameReader) -> dict[str, ValueError]:
        # Checks the columns of CSV files before long files are read. A subclass may read another
        # format, which is not checked.
        if type(self).read_trial is not RecordingFrames.read_trial:
            return {}
        paths = [Path(path) for path in self.raw_paths if path.lower().endswith(".csv")]
        first_frames = [
            UnreadRecording(
                f"'{path}'",
                self._trial_name(path),
                partial(_read_first_frame, path, self.read_options),
            )
            for path in paths
        ]
        errors = reader.first_frame_errors(first_frames)
        # Short files are read anyway, so that one list shows the errors in their other lines, too.
        if sum(path.stat().st_size for path in paths) > _MAX_BYTES_TO_LIST_ALL_ERRORS:
            raise_all([*errors.values()], len(paths))
        return errors

    def _resampled(self, unread: UnreadRecording) -> UnreadRecording:
        def read() -> Recording:
            recording = unread.read()
            if self.resample is None or recording.num_frames < 2:
                return recording
            try:
                return recording.resample(self.resample)
            except ValueError as error:
                raise ValueError(f"{unread.where}: {error}") from error

        return replace(unread, read=read)

    @property
    def file_options(self) -> dict[str, Any]:
        r"""The options with which :func:`~torch_geometric_tactile.io.read_recording` reads another
        file with the columns of this data set: :obj:`read_options`, with the ordered names of the
        columns in place of expressions.
        """
        columns = {key: self._names.get(f"{key}_columns") for key in ("tactile", "joint")}
        return {**self.read_options, **{key: names for key, names in columns.items() if names}}

    @property
    def named_units(self) -> list[str]:
        r"""The groups of :obj:`pattern` by which samples can be split, besides object and trial."""
        other_groups = ("object", "trial", "label", self.target)
        return [name for name in re.compile(self.pattern).groupindex if name not in other_groups]

    @property
    def class_names(self) -> list[str]:
        r"""The names of the classes or properties of :obj:`y`."""
        if self.target == "object":
            return self.group_names
        return self.property_names if self.target == "property" else super().class_names


def _read_first_frame(path: Path, options: Mapping[str, Any]) -> Recording:
    # Only CSV files are read in part. A file whose suffix does not match its content may have any
    # format and is read completely.
    is_csv = select_format(path, options).endswith("CSV")
    return read_recording(path, **{**options, **({"num_frames": 1} if is_csv else {})})


def _check_arguments(
    root: PathLike | None,
    recordings: Sequence[Recording] | None,
    *,
    stride: int,
    unit: str | None,
) -> None:
    need(stride >= 1, "'stride' must be at least 1", stride)
    if (root is None) == (recordings is None):
        passed = "none" if root is None else "both"
        raise ValueError(f"one of 'root' and 'recordings' must be given (got {passed})")
    if unit not in (None, *UNITS):
        raise ValueError(f"'unit' must be one of {[*UNITS]} or None (got {unit!r})")


def _warn_of_names(trials: Sequence[Trial], pattern: str) -> None:
    # The default pattern need not match, since most recordings contain their metadata.
    unmatched = [trial.where for trial in trials if re.fullmatch(pattern, trial.name) is None]
    if unmatched and pattern != DEFAULT_PATTERN:
        _logger.warning(
            "%d of %d file names do not match the pattern '%s', so their recordings get no "
            "metadata from it: %s",
            len(unmatched),
            len(trials),
            pattern,
            short_list(unmatched, _MAX_LISTED_FILES),
        )


def _warn_of_one_object(dataset: RecordingFrames) -> None:
    if len(dataset.group_names) == 1 and dataset.target == "object":
        _logger.warning(
            "'%s' holds only one object, '%s', so there is nothing to classify; choose another "
            "target with %s",
            dataset.root,
            dataset.group_names[0],
            dataset._other_target,
        )
