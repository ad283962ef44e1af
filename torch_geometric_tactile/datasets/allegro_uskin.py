r"""Grasps with an Allegro hand covered with uSkin."""

from collections.abc import Sequence
from typing import Any, Literal

from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.data._paper_objects import PROPERTIES
from torch_geometric_tactile.datasets._allegro_labels import GRASP_TARGETS, AllegroLabels
from torch_geometric_tactile.datasets.recording_frames import RecordingFrames
from torch_geometric_tactile.datasets.root import default_root
from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin

_Task = Literal["object", "property", "shape", "width", "centre", "yaw"]
_TASKS = ("object", "property", *GRASP_TARGETS)
_SPLITS_BY = ("trial", "frame", "group", "placement", "size")


class AllegroUSkin(RecordingFrames):
    r"""Grasps with a right Allegro hand whose 384 taxels are XELA uSkin, as in the "Tactile Object
    Property Recognition using Geometrical Graph Edge Features and Multi-Thread Graph Convolutional
    Network" and the "Multifingered Object Recognition with Tactile Sensors and Graph Convolutional
    Networks using Topological Graph Segmentation" papers: what is the object, or is it light or
    heavy, hard or soft, slippery or not?

    The recordings of the papers are not public. This class reads a folder of your own, or one that
    ``tactile simulate --out FOLDER`` wrote: one trial a file, in :obj:`root/raw` or in :obj:`root`
    itself, ``.h5``, ``.hdf5``, ``.npz`` or ``.csv`` as
    :func:`~torch_geometric_tactile.io.write_recording` writes a
    :class:`~torch_geometric_tactile.data.Recording`:

    * readings in counts (what :obj:`meta["unit"]` names, or names none) :math:`(T, 384, 3)`, in the
      order of :func:`~torch_geometric_tactile.sensors.allegro_uskin`, and joint angles in radians
      :math:`(T, 16)`;
    * the object's name and the number of the trial in :obj:`meta["object"]` and
      :obj:`meta["trial"]`, or in the name of the file: ``<object>_<number>.h5``;
    * for :obj:`task="property"`, 0 or 1 for each property in :obj:`meta["labels"]`, in the order of
      :obj:`property_names` or of :obj:`meta["label_names"]`; needless for objects named as in
      :func:`~torch_geometric_tactile.sim.paper8`;
    * if known, the integers :obj:`privileged["phase"]` with their :obj:`meta["phase_names"]`;
    * for other tasks, what ``tactile simulate`` writes: :obj:`meta["shape"]`, :obj:`meta["width"]`
      in metres, and :obj:`privileged["object_pose"]` and :obj:`privileged["palm_pose"]`, positions
      and quaternions :math:`(T, 7)`; to split by them, texts or integers :obj:`meta["placement"]`
      and :obj:`meta["size"]`.

    A sample is a frame. Beside :obj:`x` and :obj:`y` it has :obj:`joint`, :obj:`time` in seconds,
    :obj:`trial` (the file), :obj:`group` (the object), :obj:`property` and :obj:`phase` where
    known (-1 in files that know none), and likewise :obj:`shape`, :obj:`width`, :obj:`centre`,
    :obj:`yaw`, :obj:`placement` and :obj:`size`. Missing readings stay NaN. Positions depend on the
    joint angles and are not stored; the transforms of the example below compute them batch by
    batch.

    All files are processed once, and anew when one of them was added, removed or changed.
    :obj:`task`, :obj:`split`, :obj:`adjacency`, :obj:`phases` and :obj:`stride` select from the
    memory-mapped processed file, without a copy of the readings.

    .. list-table:: STATS
        :header-rows: 1

        * - data
          - #trials
          - #graphs
          - #nodes
          - #edges
          - #features
          - #classes
        * - as the papers describe theirs: 8 objects, about 17 s at 100 Hz
          - 80
          - ~136,000
          - 384
          - 1,401
          - 3
          - 8 objects or 6 properties
        * - ``tactile simulate``: 8 objects, 17 s at 100 Hz
          - 80
          - 136,000
          - 384
          - 1,401
          - 3
          - 8 objects or 6 properties
        * - ``tactile simulate --preset ci``: 8 objects, 5 s at 50 Hz
          - 24
          - 6,000
          - 384
          - 1,401
          - 3
          - 8 objects or 6 properties

    Args:
        root (str or PathLike, optional): Folder of the data set. If left out,
            :obj:`$TACTILE_DATA/AllegroUSkin` or a folder in the user's cache.
        task (str): What :obj:`y` is: of :obj:`"object"` and :obj:`"shape"` the index, of
            :obj:`"property"` a 0 or 1 for each property, and of the regressions :obj:`"width"` the
            object's extent between fingers and thumb in metres, :obj:`"centre"` its place in the
            palm's frame in metres :math:`(S, 3)`, and :obj:`"yaw"` the turn of its long axis about
            the palm's normal in radians, from -pi/2 to pi/2: 0 across the fingers. Frames of
            spheres, which have no yaw, are left out then.
        split (str, optional): :obj:`"train"`, :obj:`"val"` or :obj:`"test"`; everything with
            :obj:`None`.
        split_by (str): :obj:`"trial"` keeps whole trials together and holds out some of each
            object. :obj:`"frame"` draws single frames, and is the optimistic one: neighbours in
            time are nearly equal, so that the test frames were nearly seen before. The papers do
            not say which of them they used. :obj:`"group"` holds out whole objects,
            :obj:`"placement"` placements of the hand (one of nine, see
            :class:`~torch_geometric_tactile.sim.GraspSpread`), and :obj:`"size"` all objects of the
            same width in whole centimetres.
        fractions (tuple of float): The parts for training, validation and test. With whole trials,
            each object has at least one to train and to test on, and from three trials on one for
            validation. The second paper has :obj:`(0.6, 0.1, 0.3)`.
        split_seed (int): Which of the random splits. :obj:`phases`, :obj:`stride` and the like
            move no frame to another split.
        adjacency (str): Which edges of the layout.
        layout (TaxelLayout or str or PathLike, optional): The taxels: a layout, the name of one
            that comes with the package, or a layout file;
            :func:`~torch_geometric_tactile.sensors.allegro_uskin` if left out.
        phases (sequence of str, optional): Only the frames in these phases of the grasp.
        stride (int): Only every :obj:`stride`-th frame of each trial.
        rate (float, optional): Only the frames that are next in time to the ticks of a clock, so
            many a second, that starts with the first frame of each trial.
        samples_per_trial (int, optional): Only so many frames of each trial, drawn from those that
            all of the above leave of it; which ones follows from :obj:`sample_seed` and the name of
            the trial.
        sample_seed (int): Which of them are drawn.
        tare (float or str, optional): The frames at rest of each trial, whose mean reading is
            subtracted from all of its frames before :obj:`transform`: the name of a phase, such as
            :obj:`"hover"`, or how many seconds each trial begins with. Frames at rest count also
            where :obj:`phases`, :obj:`stride` and the like or :obj:`split` leave them out.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved (for each
            :obj:`task` and :obj:`adjacency`).
        pre_filter (callable, optional): Tells whether a sample is kept (likewise).
        force_reload (bool): Whether to process the raw files anew.

    Raises:
        FileNotFoundError: If there are no trials.
        ValueError: If an argument is unknown or leaves no sample, a file cannot be read or is not
            as described above, two files hold the same trial or contradict each other on the
            properties of an object, or these are unknown where they are the task.

    Examples:
        >>> from torch_geometric.transforms import Compose
        >>> from torch_geometric_tactile.sensors import HandKinematics
        >>> from torch_geometric_tactile.transforms import GeometricEdgeAttr, TaxelPose
        >>> transform = Compose(
        ...     [TaxelPose(allegro_uskin(), HandKinematics.allegro()), GeometricEdgeAttr()]
        ... )
        >>> dataset = AllegroUSkin("sim", task="property", transform=transform)  # doctest: +SKIP
        >>> dataset  # doctest: +SKIP
        AllegroUSkin(95200)
        >>> dataset[0]  # doctest: +SKIP
        Data(x=[384, 3], edge_index=[2, 1401], edge_attr=[1401, 4], y=[1, 6], pos=[384, 3], ...)
    """

    num_channels = 3
    num_joints = 16
    _stored = _TASKS
    _needs = ("object", "trial")
    _labels = AllegroLabels()
    _other_target = "task='property' or task='shape'"
    _processed_name = "allegro_uskin.pt"

    def __init__(
        self,
        root: PathLike | None = None,
        task: _Task = "object",
        split: Literal["train", "val", "test"] | None = "train",
        *,
        split_by: Literal["trial", "frame", "group", "placement", "size"] = "trial",
        fractions: tuple[float, float, float] = (0.7, 0.1, 0.2),
        split_seed: int = 0,
        adjacency: str = "original",
        layout: TaxelLayout | PathLike | None = None,
        phases: Sequence[str] | None = None,
        stride: int = 1,
        rate: float | None = None,
        samples_per_trial: int | None = None,
        sample_seed: int = 0,
        tare: float | str | None = None,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        need(task in _TASKS, f"'task' must be one of {_TASKS} (got '{task}')")
        need(split_by in _SPLITS_BY, f"'split_by' must be one of {_SPLITS_BY} (got '{split_by}')")
        self.task = task
        self.split_by = split_by
        self.fractions = _checked_fractions(fractions)
        _, val, test = self.fractions
        stratify = "group" if split_by == "trial" else None
        super().__init__(
            default_root("AllegroUSkin") if root is None else root,
            allegro_uskin() if layout is None else layout,
            target=task,
            split=split,
            protocol=Protocol(split_by, val=val, test=test, stratify=stratify),
            split_seed=split_seed,
            adjacency=adjacency,
            phases=phases,
            stride=stride,
            rate=rate,
            samples_per_trial=samples_per_trial,
            sample_seed=sample_seed,
            tare=tare,
            unit="count",
            transform=transform,
            pre_transform=pre_transform,
            pre_filter=pre_filter,
            force_reload=force_reload,
        )

    @property
    def class_names(self) -> list[str]:
        r"""The names of the classes, labels or numbers of :obj:`y`."""
        if self.task in GRASP_TARGETS:
            return list(GRASP_TARGETS[self.task]) or self.shape_names
        return super().class_names

    @property
    def shape_names(self) -> list[str]:
        r"""The names of the shapes in :obj:`shape`; empty if a recording knows none."""
        return list(self._names["shape"])

    @property
    def property_names(self) -> list[str]:
        r"""The names of the columns of :obj:`property`."""
        return list(PROPERTIES)

    @property
    def _held_out(self) -> str:
        return f"fractions={self.fractions}"

    def _in_split(self, split: str) -> Tensor:
        try:
            return super()._in_split(split)
        except ValueError as error:
            if self.split_by == "frame":
                raise
            raise ValueError(
                f"{error}: record more, or choose split_by='frame' or split=None"
            ) from error

    def _no_files(self) -> str:
        return f"{super()._no_files()}, or simulate some: tactile simulate --out '{self.root}'"


def _checked_fractions(fractions: Any) -> tuple[float, float, float]:
    try:
        train, val, test = (float(part) for part in fractions)
        is_right = min(train, val, test) >= 0 and train > 0 and abs(train + val + test - 1) < 1e-6
    except (TypeError, ValueError):
        is_right = False
    if not is_right:
        raise ValueError(
            "'fractions' must be three numbers, not negative and the first positive, that add up "
            f"to 1 (got {fractions})"
        )
    return train, val, test
