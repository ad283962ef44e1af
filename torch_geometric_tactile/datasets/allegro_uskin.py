r"""Grasps with an Allegro hand covered with uSkin."""

from collections.abc import Sequence
from typing import Any, Literal

from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.data._paper_objects import PROPERTIES
from torch_geometric_tactile.datasets._allegro_labels import GRASP_TARGETS, AllegroLabels
from torch_geometric_tactile.datasets._root import default_root
from torch_geometric_tactile.datasets.recording_frames import RecordingFrames
from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin

_Task = Literal["object", "property", "shape", "width", "centre", "yaw"]
_TASKS = ("object", "property", *GRASP_TARGETS)
_SPLITS_BY = ("trial", "frame", "group", "placement", "size")


class AllegroUSkin(RecordingFrames):
    r"""Grasps with a right Allegro hand covered with 384 XELA uSkin taxels, as in the "Tactile
    Object Property Recognition using Geometrical Graph Edge Features and Multi-Thread Graph
    Convolutional Network" and the "Multifingered Object Recognition with Tactile Sensors and Graph
    Convolutional Networks using Topological Graph Segmentation" papers. The tasks are to recognise
    the object or its properties: light or heavy, hard or soft, slippery or not.

    The recordings of the papers are not public. This class reads a folder of your own recordings,
    or of recordings simulated by ``tactile simulate --out FOLDER``. Each file in :obj:`root/raw` or
    :obj:`root` is one trial, in a format of
    :func:`~torch_geometric_tactile.io.write_recording`: ``.h5``, ``.hdf5``, ``.npz`` or ``.csv``. A
    file contains:

    * readings in counts :math:`(T, 384, 3)`, in the order of
      :func:`~torch_geometric_tactile.sensors.allegro_uskin`, and joint angles in radians
      :math:`(T, 16)`; :obj:`meta["unit"]` is :obj:`"count"` or missing;
    * the name of the object and the number of the trial in :obj:`meta["object"]` and
      :obj:`meta["trial"]`, or in the name of the file: ``<object>_<number>.h5``;
    * for :obj:`task="property"`, 0 or 1 for each property in :obj:`meta["labels"]`, in the order of
      :obj:`property_names` or of :obj:`meta["label_names"]` (not needed for objects named as in
      :func:`~torch_geometric_tactile.sim.paper8`);
    * optionally, the integers :obj:`privileged["phase"]` with their :obj:`meta["phase_names"]`;
    * for the tasks other than object and property, :obj:`meta["shape"]`, :obj:`meta["width"]` in
      metres, and the positions and quaternions :obj:`privileged["object_pose"]` and
      :obj:`privileged["palm_pose"]` :math:`(T, 7)`, as ``tactile simulate`` writes them;
    * for splits by placement or size, texts or integers :obj:`meta["placement"]` and
      :obj:`meta["size"]`.

    A sample is a frame. Besides :obj:`x` and :obj:`y`, it has :obj:`joint`, :obj:`time` in seconds,
    :obj:`trial` (the file) and :obj:`group` (the object). If they are known, it also has
    :obj:`property`, :obj:`phase` (-1 in files without phases), :obj:`shape`, :obj:`width`,
    :obj:`centre`, :obj:`yaw`, :obj:`placement` and :obj:`size`. Missing readings stay NaN.
    Positions depend on the joint angles and are not stored; the transforms in the example below
    compute them for each batch.

    All files are processed once, and again when a file is added, removed or changed.
    :obj:`task`, :obj:`split`, :obj:`adjacency`, :obj:`phases` and :obj:`stride` select from the
    memory-mapped processed file without copying the readings.

    .. list-table:: STATS
        :header-rows: 1

        * - data
          - #trials
          - #graphs
          - #nodes
          - #edges
          - #features
          - #classes
        * - data of the papers, as described: 8 objects, about 17 s at 100 Hz
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
        root (str or PathLike, optional): Folder of the data set. The default is
            :obj:`$TACTILE_DATA/AllegroUSkin`, or a folder in the user's cache if that variable is
            not set.
        task (str): The target :obj:`y`:

            * :obj:`"object"`, :obj:`"shape"`: a class index.
            * :obj:`"property"`: 0 or 1 for each property.
            * :obj:`"width"`: the extent of the object between fingers and thumb in metres.
            * :obj:`"centre"`: the position of the object in the palm's frame in metres
              :math:`(S, 3)`.
            * :obj:`"yaw"`: the rotation of the object's long axis about the palm's normal in
              radians, from -pi/2 to pi/2, where 0 is across the fingers. Spheres have no yaw; their
              frames are left out.
        split (str, optional): :obj:`"train"`, :obj:`"val"`, :obj:`"test"`, or :obj:`None` for all
            frames.
        split_by (str): The unit that is held out. The papers do not state whether they split by
            trial or by frame.

            * :obj:`"trial"`: complete trials of each object.
            * :obj:`"frame"`: single frames. The results are optimistic, since a test frame is
              nearly equal to its neighbours in time.
            * :obj:`"group"`: complete objects.
            * :obj:`"placement"`: placements of the hand (one of nine, see
              :class:`~torch_geometric_tactile.sim.GraspSpread`).
            * :obj:`"size"`: all objects of the same width, rounded to centimetres.
        fractions (tuple of float): Fractions for training, validation and test. If complete trials
            are held out, each object has at least one training and one test trial, and also a
            validation trial if it has three or more trials. The second paper uses
            :obj:`(0.6, 0.1, 0.3)`.
        split_seed (int): Seed of the random split. The split of a frame does not depend on
            :obj:`phases`, :obj:`stride`, :obj:`rate` or :obj:`samples_per_trial`.
        adjacency (str): Name of an adjacency of the layout, whose edges are used.
        layout (TaxelLayout or str or PathLike, optional): The taxels: a layout, the name of a
            layout of the package, or a layout file. The default is
            :func:`~torch_geometric_tactile.sensors.allegro_uskin`.
        phases (sequence of str, optional): Selects the frames in these phases of the grasp.
        stride (int): Selects every :obj:`stride`-th frame of each trial.
        rate (float, optional): Rate in hertz at which frames are selected: the frames nearest in
            time to the ticks of a clock that starts with the first frame of each trial.
        samples_per_trial (int, optional): Number of frames of each trial, drawn at random after the
            selections above. The draw depends only on :obj:`sample_seed` and the name of the trial.
        sample_seed (int): Seed of :obj:`samples_per_trial`.
        tare (float or str, optional): The frames at rest: the name of a phase, such as
            :obj:`"hover"`, or the number of seconds at the start of each trial. Their mean reading
            is subtracted from all frames of the same trial before :obj:`transform`. Frames at rest
            are used even if they are not selected.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once for each :obj:`task` and :obj:`adjacency`,
            before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample. Applied once for each
            :obj:`task` and :obj:`adjacency`.
        force_reload (bool): Whether to process the raw files again.

    Raises:
        FileNotFoundError: If there are no trials.
        ValueError: If an argument is unknown or leaves no sample, a file cannot be read or lacks
            the content above, two files hold the same trial or different properties of the same
            object, or the target is unknown.

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
        r"""The names of the classes or columns of :obj:`y`."""
        if self.task in GRASP_TARGETS:
            return list(GRASP_TARGETS[self.task]) or self.shape_names
        return super().class_names

    @property
    def shape_names(self) -> list[str]:
        r"""The names of the shapes in :obj:`shape`. The list is empty if a shape is unknown."""
        return list(self._names["shape"])

    @property
    def property_names(self) -> list[str]:
        r"""The names of the columns of :obj:`property`."""
        return list(PROPERTIES)

    @property
    def _split_text(self) -> str:
        return f"fractions={self.fractions}"

    def _split_mask(self, split: str) -> Tensor:
        try:
            return super()._split_mask(split)
        except ValueError as error:
            if self.split_by == "frame":
                raise
            raise ValueError(
                f"{error}: record more trials, or choose split_by='frame' or split=None"
            ) from error

    def _no_files(self) -> str:
        return f"{super()._no_files()}, or simulate some: tactile simulate --out '{self.root}'"


def _checked_fractions(fractions: Any) -> tuple[float, float, float]:
    try:
        train, val, test = (float(part) for part in fractions)
        is_valid = min(train, val, test) >= 0 and train > 0 and abs(train + val + test - 1) < 1e-6
    except (TypeError, ValueError):
        is_valid = False
    if not is_valid:
        raise ValueError(
            "'fractions' must be three numbers that add up to 1, the first positive and none "
            f"negative (got {fractions})"
        )
    return train, val, test
