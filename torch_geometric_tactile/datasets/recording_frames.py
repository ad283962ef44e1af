r"""The frames of recordings, for any sensor."""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import FrameInfo, Protocol, Recording, StaticData
from torch_geometric_tactile.data.recording import UNITS
from torch_geometric_tactile.datasets._frame_labels import ObjectLabels, frame_labels
from torch_geometric_tactile.datasets._frame_reader import FrameReader
from torch_geometric_tactile.datasets._splits import checked_split
from torch_geometric_tactile.datasets._trial import checked_pattern
from torch_geometric_tactile.datasets._trial_frames import (
    PARTS,
    TrialFrames,
    check_choice,
)
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.sensors import TaxelLayout, as_layout

_PATTERN = r"(?P<object>.+)_(?P<trial>\d+)"
# Arguments, also of subclasses, that choose from the processed frames.
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
_logger = logging.getLogger(__name__)


class RecordingFrames(TrialFrames):
    r"""The frames of a folder of recordings, or of recordings in memory, for any layout, any number
    of channels and any number of joints (or none). A sample is a frame.

    The folder has one trial a file, in :obj:`root/raw` or in :obj:`root` itself: ``.h5``,
    ``.hdf5``, ``.npz``, ``.mcap`` or ``.csv``, as
    :func:`~torch_geometric_tactile.io.read_recording` reads them. Beside :obj:`x` and :obj:`y` a
    sample has :obj:`trial` (the file), :obj:`time` in seconds, and, where all files know them,
    :obj:`joint`, :obj:`group` (the object), :obj:`session`, :obj:`placement` (of the hand),
    :obj:`size` (of the object) and :obj:`property`; :obj:`phase` is -1 in files that know none.
    Missing readings stay NaN. If the layout has one link, the samples share its :obj:`pos` and
    :obj:`normal`; those of a hand follow from the joint angles, see
    :class:`~torch_geometric_tactile.transforms.TaxelPose`.

    What is known of a recording is read from its metadata or from the name of its file: with the
    :obj:`pattern` that is the default, ``mug_003.csv`` is trial 3 of the object ``mug``. Two CSV
    files beside the recordings, or in :obj:`root`, may tell more of them: ``annotations.csv``, with
    the columns ``recording``, ``start``, ``end`` and ``label``, and ``labels.csv``, with
    ``recording``, ``label`` and further columns, which are metadata. They add to what the files
    tell, and do not contradict it.

    All files are processed once, and anew when one of them was added, removed or changed.
    :obj:`split`, :obj:`phases` and :obj:`stride` select from the memory-mapped processed file,
    without a copy of the readings.

    Args:
        root (str or PathLike, optional): Folder of the data set.
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of one that comes
            with the package, or a layout file.
        recordings (sequence of Recording, optional): Recordings in memory, in place of
            :obj:`root`.
        target (str): What :obj:`y` is: :obj:`"object"`, its index in :obj:`group_names`;
            :obj:`"property"`, a 0 or 1 for each of the :obj:`"label_names"` in the metadata, from
            the metadata's :obj:`"labels"`; :obj:`"label"`, the label of the recording;
            :obj:`"annotation"`, the label of the annotation that covers a frame, and :obj:`"none"`
            outside of all of them; or another key of the metadata, of the file's name, or of
            :obj:`privileged` (frame by frame), such as the name of the label's column in CSV files.
        split (str, optional): :obj:`"train"`, :obj:`"val"` or :obj:`"test"`; everything with
            :obj:`None`.
        protocol (Protocol, optional): What is held out; if left out, whole trials, of every class
            where there are enough.
        split_seed (int): Which of the random splits. :obj:`phases`, :obj:`stride` and the like
            move no frame to another split.
        fold (int): Which fold of a protocol with folds is tested on.
        adjacency (str, optional): Which edges of the layout. If left out, :obj:`"original"`, or its
            only ones; without such, a :obj:`pre_transform` such as
            :class:`~torch_geometric_tactile.transforms.KNNGraph` may add some.
        phases (sequence of str, optional): Only the frames in these phases, of
            :obj:`privileged["phase"]` and :obj:`meta["phase_names"]`.
        stride (int): Only every :obj:`stride`-th frame of each trial.
        rate (float, optional): Only the frames that are next in time to the ticks of a clock, so
            many a second, that starts with the first frame of each trial.
        samples_per_trial (int, optional): Only so many frames of each trial, drawn from those that
            all of the above leave of it; which ones follows from :obj:`sample_seed` and the name of
            the trial.
        sample_seed (int): Which of them are drawn.
        pattern (str): Regular expression for the whole name of a file without its suffix. Its named
            groups are known of the recording, such as :obj:`object`, :obj:`trial`, :obj:`session`
            and :obj:`label`. With a :obj:`"/"` in it, files in subfolders are read as well, and
            their names have the folders in front.
        read_options (Mapping, optional): Options of
            :func:`~torch_geometric_tactile.io.read_recording`, such as the names of columns.
            Columns that an expression chooses are in the order of the first file in all files.
        unit (str, optional): The unit of recordings whose metadata name none, :obj:`"count"` or
            :obj:`"newton"`. Without it, all recordings name one, or none does.
        resample (float, optional): Frames per second that all recordings are resampled to before
            anything else, see :meth:`Recording.resample
            <torch_geometric_tactile.data.Recording.resample>`: for windows of recordings that have
            several rates.
        tare (float or str, optional): The frames at rest of each trial, whose mean reading is
            subtracted from all of its frames before :obj:`transform`: the name of a phase, such as
            :obj:`"hover"`, or how many seconds each trial begins with. Frames at rest count also
            where :obj:`phases`, :obj:`stride` and the like or :obj:`split` leave them out.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw files anew.

    Raises:
        FileNotFoundError: If there are no recordings.
        ValueError: If an argument is unknown or leaves no sample, a recording cannot be read or
            does not fit the layout or the others, a table names a file that is not there or tells
            another label, annotations with different labels overlap on a frame of the target
            :obj:`"annotation"`, two hold the same trial or contradict each other on the properties
            of an object, units differ, or one does not tell what :obj:`target` asks for.

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

    num_channels: int | None = None  # of a taxel; any number with None
    num_joints: int | None = None
    _stored: tuple[str, ...] = ("object", "property")  # targets that are in every processed file
    _needs: tuple[str, ...] = ()  # "object" and "trial", if every recording must know them
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
        pattern: str = _PATTERN,
        read_options: Mapping[str, Any] | None = None,
        unit: Literal["count", "newton", "microtesla"] | None = None,
        resample: float | None = None,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        _check_arguments(root, recordings, stride=stride, unit=unit)
        check_choice(rate, samples_per_trial, sample_seed)
        if resample is not None:
            FrameInfo(rate=resample, resampled=True)  # checks it
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
        self._tare()
        self._select()

    @property
    def processed_dir(self) -> str:
        r"""The folder of the processed file: one of its own for what a filter or transform saw."""
        folder = Path(self.root, "processed")
        own = f"{self.target}_{self.adjacency}"
        return str(folder / own if self._is_filtered else folder)

    @property
    def _is_filtered(self) -> bool:
        return self.pre_transform is not None or self.pre_filter is not None

    def _set_after_loading(self) -> tuple[str, ...]:
        # Edges and labels of known kinds, unless a filter or transform has seen them. Of a layout
        # with several links nothing else is stored.
        if self._is_filtered:
            return ()
        target = ("target", "task") if self.target in self._stored else ()
        layout = ("layout",) if len(self.layout.link_names) > 1 else ()
        return ("adjacency", *target, *layout)

    def read_trial(self, path: PathLike) -> Recording:
        r"""Reads the recording in a file; a subclass may read a format of its own.

        Args:
            path (str or PathLike): The file.
        """
        recording = read_recording(path, **self.read_options)
        column = self.read_options.get("label")
        if self.target != column or column == "label" or recording.label is None:
            return recording
        # The labels of a file whose column happens to be the same in all frames.
        labels = np.full(recording.num_frames, recording.label)
        return replace(recording, privileged={**recording.privileged, self.target: labels})

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all trials."""
        needs = {*self._needs, *(["object"] if self.target == "object" else [])}
        reader = FrameReader(
            self.layout, self.pattern, tuple(needs), self.num_channels, self.num_joints, self.unit
        )
        if self._recordings is None:
            x, trials = reader.read(self._resampled(self._opened()), Path(self.processed_dir))
        else:
            given = ((f"recording {i}", str(i), r) for i, r in enumerate(self._recordings))
            x, trials = reader.read(self._resampled(given), None)
        target = None if self.target in self._stored else self.target
        names, labels = frame_labels(trials, self._labels, target)
        for trial in reversed(trials):
            names |= {f"{key}_columns": own for key, own in trial.columns.items()}
        unit = trials[0].meta.get("unit", self.unit)
        names["unit"] = [] if unit is None else [unit]
        data = StaticData(x=x, **labels)
        if self.adjacency is not None:
            data.edge_index = self.layout.edge_index(self.adjacency)
        if len(self.layout.link_names) == 1:
            data.pos, data.normal = self.layout.pos, self.layout.normal
        for key, value in self._labels.more(trials, names).items():
            data[key] = value
        data.y = self._labels.target(data, names, self.target, str(self.root))
        return data, names

    def _resampled(
        self, recordings: Iterable[tuple[str, str, Recording]]
    ) -> Iterator[tuple[str, str, Recording]]:
        for where, name, recording in recordings:
            if self.resample is None or recording.num_frames < 2:
                yield where, name, recording
                continue
            try:
                yield where, name, recording.resample(self.resample)
            except ValueError as error:
                raise ValueError(f"{where}: {error}") from error

    @property
    def file_options(self) -> dict[str, Any]:
        r"""The options of :func:`~torch_geometric_tactile.io.read_recording` that read another file
        as those of this data set: :obj:`read_options` with the names of the columns, in their
        order, in place of expressions.
        """
        known = {key: self._names.get(f"{key}_columns") for key in ("tactile", "joint")}
        return {**self.read_options, **{key: names for key, names in known.items() if names}}

    @property
    def class_names(self) -> list[str]:
        r"""The names of the classes or labels of :obj:`y`."""
        if self.target == "object":
            return self.group_names
        return self.property_names if self.target == "property" else super().class_names


def _check_arguments(
    root: PathLike | None,
    recordings: Sequence[Recording] | None,
    *,
    stride: int,
    unit: str | None,
) -> None:
    need(stride >= 1, "'stride' must be at least 1", stride)
    if (root is None) == (recordings is None):
        both = "none" if root is None else "both"
        raise ValueError(f"one of 'root' and 'recordings' must be given (got {both})")
    if unit not in (None, *UNITS):
        raise ValueError(f"'unit' must be one of {[*UNITS]} or None (got {unit!r})")


def _warn_of_one_object(dataset: RecordingFrames) -> None:
    if len(dataset.group_names) == 1 and dataset.target == "object":
        _logger.warning(
            "'%s' holds one object only, '%s': there is nothing to tell apart; learn something "
            "else with %s",
            dataset.root,
            dataset.group_names[0],
            dataset._other_target,
        )
