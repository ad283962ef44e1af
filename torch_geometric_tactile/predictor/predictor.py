r"""Predictors, which turn raw readings into probabilities."""

import copy
from collections.abc import Sequence
from typing import Any, Self

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike, Transform
from torch_geometric_tactile.data import (
    ContactRule,
    FrameInfo,
    Recording,
    StaticData,
    StaticDataset,
)
from torch_geometric_tactile.predictor import _content
from torch_geometric_tactile.predictor._hub import predictor_file, push_predictor
from torch_geometric_tactile.predictor._network import Network, Task
from torch_geometric_tactile.predictor._preparation import Preparation, add_tare, shared_attributes
from torch_geometric_tactile.predictor._readings import ArrayLike, array_shape
from torch_geometric_tactile.predictor._window_cut import WindowCut
from torch_geometric_tactile.predictor.measured_score import MeasuredScore
from torch_geometric_tactile.sensors import TaxelLayout


class Predictor:
    r"""A trained model together with the layout of its sensor, the fitted transforms and the names
    of its classes. A predictor reads raw readings of the sensor and returns probabilities.

    The model and the transforms are copied. The model is always in evaluation mode. Attributes that
    depend only on the layout, such as a nearest-neighbour graph, are computed once.

    Missing readings (NaN) pass through the transforms like all other readings. Unless a transform
    is :class:`~torch_geometric_tactile.transforms.FillMissing`, the probabilities of a frame with
    missing readings are NaN, and :meth:`labels` returns no label for it. Other frames are not
    affected.

    Args:
        model (torch.nn.Module): The model. It is called as :obj:`model(x, edge_index)` with the
            attributes listed in its :obj:`modalities` as keyword arguments, and returns logits
            :math:`(B, C)`. If its :obj:`forward` has an argument :obj:`batch`, it is called with
            the PyG batch of the frames.
        layout (TaxelLayout): The taxels.
        transform (callable, optional): The transform of each reading. It must be fitted if it needs
            fitting. Use PyG's :class:`~torch_geometric.transforms.Compose` to combine several.
        class_names (sequence of str): Names of the classes or labels. If left out, classes have
            only numbers.
        task (str): :obj:`"multiclass"` (one class per frame), :obj:`"multilabel"` (0 or 1 for each
            label) or :obj:`"regression"` (numbers).
        adjacency (str or torch.Tensor, optional): The edges before any transform: the name of an
            adjacency of the layout, or edges :math:`(2, |\mathcal{E}|)`.
        pre_transform (callable, optional): The transform that is applied before :obj:`transform`.
            Data for :meth:`prepare_samples` must already be transformed by it.
        num_channels (int, optional): Number of channels per taxel. Not checked if left out.
        num_joints (int, optional): Number of joint angles per frame. Not checked if left out.
        threshold (float, optional): For two classes, the probability of class 1 above which
            :meth:`labels` returns class 1. Defaults to one half.
        info (FrameInfo, optional): Unit, column order, frame rate and thinning of the training
            frames. Recordings must match. :meth:`from_dataset` reads it from the data set.
        contact (ContactRule, optional): The rule that detects frames without contact. Their
            probabilities are NaN, and their label is :obj:`"no contact"`. The rule compares
            readings with its own readings at rest, or with readings that :meth:`adapt` or
            :meth:`adapt_recording` measured last. A window has no contact if none of its frames has
            contact. The attribute can be changed later.

    A model that was trained on :class:`~torch_geometric_tactile.data.Windows` or
    :class:`~torch_geometric_tactile.data.Trials` reads windows of raw frames.
    :meth:`recording` and :meth:`windows` cut windows from a
    :class:`~torch_geometric_tactile.data.Recording`.

    Shapes:
        - **reading:** :math:`(N, F)` or :math:`(B, N, F)`; windows :math:`(N, C \cdot T)` or
          :math:`(B, N, C \cdot T)`
        - **joint:** angles in radians :math:`(J,)` or :math:`(B, J)`
        - **output:** probabilities :math:`(C,)` for one frame, or :math:`(B, C)`; numbers for a
          regression

    Raises:
        ValueError: If :obj:`task` is unknown. A call raises this error if the shape of a reading is
            wrong, or if the transforms or the model need a missing attribute.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> from torch_geometric_tactile.nn.models import GraspGCN
        >>> from torch_geometric_tactile.transforms import KNNGraph
        >>> dataset = FakeTactileDataset(num_samples=100, pre_transform=KNNGraph(k=2))
        >>> predictor = Predictor.from_dataset(GraspGCN(), dataset)
        >>> predictor
        Predictor(GraspGCN, 'biotac_sp', classes=['stable', 'slip'], task='multiclass')
        >>> predictor(dataset[0].x).shape
        torch.Size([2])
    """

    def __init__(
        self,
        model: Module,
        layout: TaxelLayout,
        transform: Transform | None = None,
        class_names: Sequence[str] = (),
        task: Task = "multiclass",
        *,
        adjacency: str | Tensor | None = None,
        pre_transform: Transform | None = None,
        num_channels: int | None = None,
        num_joints: int | None = None,
        threshold: float | None = None,
        info: FrameInfo | None = None,
        contact: ContactRule | None = None,
    ) -> None:
        shared = shared_attributes(layout, adjacency)
        preparation = Preparation(
            layout,
            shared,
            pre_transform,
            transform,
            num_channels,
            num_joints,
            info=info,
            contact=contact,
        )
        self._set_parts(preparation, Network(copy.deepcopy(model), class_names, task, threshold))

    @classmethod
    def _from_parts(cls, preparation: Preparation, network: Network) -> Self:
        predictor = cls.__new__(cls)
        predictor._set_parts(preparation, network)
        return predictor

    def _set_parts(self, preparation: Preparation, network: Network) -> None:
        self.preparation, self.network = preparation, network
        network.model.eval()
        # A model may read joint angles that no transform reads.
        if "joint" in network.modalities:
            preparation.needs_joint = True
        self.to(network.device)

    @classmethod
    def from_dataset(
        cls,
        model: Module,
        dataset: StaticDataset,
        transform: Transform | None = None,
        task: Task = "multiclass",
        threshold: float | None = None,
    ) -> Self:
        r"""Returns the predictor for a model that was trained on a data set. The predictor has the
        layout, edges, transforms and class names of the data set.

        Args:
            model (torch.nn.Module): The model.
            dataset (StaticDataset): The data set.
            transform (callable, optional): The transform that training applied after the transform
                of the data set, such as a fitted scaler.
            task (str): As in :class:`Predictor`.
            threshold (float, optional): As in :class:`Predictor`.
        """
        preparation = Preparation.from_dataset(dataset, transform)
        network = Network(copy.deepcopy(model), dataset.class_names, task, threshold)
        return cls._from_parts(preparation, network)

    @classmethod
    def from_checkpoint(
        cls,
        path: PathLike,
        model: Module | None = None,
        transforms: Sequence[Transform] | None = None,
    ) -> Self:
        r"""Returns the predictor in a checkpoint written by ``tactile fit``. Lightning is not
        needed.

        Args:
            path (str or PathLike): The checkpoint.
            model (torch.nn.Module, optional): As in :meth:`load`.
            transforms (sequence of callable, optional): As in :meth:`load`.

        Raises:
            FileNotFoundError: If the file does not exist.
            ValueError: If the file cannot be read, or for the reasons listed in :meth:`load`.
        """
        return cls._from_parts(*_content.load_checkpoint(path, model, transforms))

    @classmethod
    def load(
        cls,
        path: PathLike,
        model: Module | None = None,
        transforms: Sequence[Transform] | None = None,
    ) -> Self:
        r"""Reads a predictor from a file written by :meth:`save`. Only models and transforms of
        this package, and some transforms of PyG, are built by their names. No code in the file is
        run.

        Args:
            path (str or PathLike): The file, or the name of a predictor of the package, as listed
                by :func:`~torch_geometric_tactile.predictor.stock_predictors`. An existing file has
                precedence over a name.
            model (torch.nn.Module, optional): The model, if it cannot be built from the file, such
                as your own model. It must have the class and sizes of the saved model; the weights
                come from the file.
            transforms (sequence of callable, optional): The transforms that cannot be built from
                the file, such as your own transforms. They must have the class and :obj:`repr` of
                the saved transforms; their fitted state comes from the file. Additional transforms
                are ignored.

        Raises:
            FileNotFoundError: If there is no such file or name.
            ValueError: If the file is damaged or from another version, or if :obj:`model` or
                :obj:`transforms` are missing or differ from the saved objects.

        Examples:
            >>> predictor = Predictor.load("biotac_sp_slip")
            >>> predictor.class_names
            ('stable', 'slip')
        """
        return cls._from_parts(*_content.load(path, model, transforms))

    def save(self, path: PathLike) -> None:
        r"""Writes the predictor to one file with JSON and tensors, in the safetensors format. If
        writing fails, no partial file is left.

        Args:
            path (str or PathLike): The file.
        """
        _content.save(self.preparation, self.network, path)

    @classmethod
    def from_pretrained(
        cls,
        path_or_repo_id: PathLike,
        *,
        revision: str | None = None,
        token: str | bool | None = None,
        cache_dir: PathLike | None = None,
        local_files_only: bool = False,
        force_download: bool = False,
        model: Module | None = None,
        transforms: Sequence[Transform] | None = None,
    ) -> Self:
        r"""Reads a predictor from a repository on the Hugging Face Hub, or from a folder or a file.
        The downloaded file is read as in :meth:`load`, without running any code in it.

        Args:
            path_or_repo_id (str or PathLike): The name of the repository, such as
                :obj:`"user/slip"`, the path of a file, or a folder with :obj:`model.predictor`.
            revision (str, optional): The branch, tag or commit. Defaults to :obj:`"main"`.
            token (str or bool, optional): The access token. :obj:`False` sends no token. By
                default, the stored token is sent.
            cache_dir (str or PathLike, optional): The folder for downloaded files. Defaults to the
                cache of :obj:`huggingface_hub`.
            local_files_only (bool): Whether to use only downloaded files, without a connection.
            force_download (bool): Whether to download the file again.
            model (torch.nn.Module, optional): As in :meth:`load`.
            transforms (sequence of callable, optional): As in :meth:`load`.

        Raises:
            ConnectionError: If the hub cannot be reached and the file was not downloaded before.
            FileNotFoundError: If there is no such repository, revision or file, or the token does
                not allow reading it.
            ImportError: If :obj:`huggingface_hub` is missing. Local files do not need it.
            PermissionError: If the terms of use of the repository are not accepted.
            ValueError: If the name is not a valid repository name, or for the reasons listed in
                :meth:`load`.

        Examples:
            >>> Predictor.from_pretrained("user/slip")  # doctest: +SKIP
        """
        path = predictor_file(
            path_or_repo_id,
            revision=revision,
            token=token,
            cache_dir=cache_dir,
            local_files_only=local_files_only,
            force_download=force_download,
        )
        return cls.load(path, model, transforms)

    def push_to_hub(
        self,
        repo_id: str,
        *,
        token: str | bool | None = None,
        private: bool | None = None,
        commit_message: str = "Upload predictor",
        revision: str | None = None,
    ) -> str:
        r"""Uploads the predictor to a repository on the Hugging Face Hub and returns the URL of the
        commit. The repository is created if it does not exist. It receives the file written by
        :meth:`save` as :obj:`model.predictor`, and a model card (:obj:`README.md`) with task,
        classes, sensor and score. Existing files with these names are replaced.

        Args:
            repo_id (str): The name of the repository, such as :obj:`"user/slip"`.
            token (str or bool, optional): An access token with write permission. Defaults to the
                stored token.
            private (bool, optional): Whether a new repository is private. Defaults to the setting
                of the account.
            commit_message (str): The message of the commit.
            revision (str, optional): The branch. It is created if it does not exist. Defaults to
                :obj:`"main"`.

        Raises:
            ConnectionError: If the hub cannot be reached.
            ImportError: If :obj:`huggingface_hub` is missing.
            PermissionError: If the token does not allow writing to the repository.
            ValueError: If the name is not a valid repository name, or the model cannot be saved.

        Examples:
            >>> predictor.push_to_hub("user/slip", private=True)  # doctest: +SKIP
        """
        return push_predictor(
            self,
            repo_id,
            token=token,
            private=private,
            commit_message=commit_message,
            revision=revision,
        )

    @property
    def layout(self) -> TaxelLayout:
        r"""The layout of the sensor."""
        return self.preparation.layout

    @property
    def transform(self) -> Transform | None:
        r"""The fitted transform of each reading."""
        return self.preparation.transform

    @property
    def read_options(self) -> dict[str, Any]:
        r"""The options with which :func:`~torch_geometric_tactile.io.read_recording` reads files
        like the training files, such as column names and the number of channels. Empty if the
        training data was not read from files.
        """
        return dict(self.preparation.read_options)

    @property
    def window(self) -> WindowCut | None:
        r"""The settings with which windows are cut: length, hop and treatment of short recordings.
        :obj:`None` for a model that reads single frames.
        """
        return self.preparation.window

    @property
    def info(self) -> FrameInfo:
        r"""The unit, columns, frame rate and thinning of the training frames. Recordings and live
        frames with another unit are rejected. A different frame rate is rejected if the model
        depends on the frame rate.
        """
        return self.preparation.info

    @property
    def causal(self) -> bool:
        r"""Whether a prediction uses no frames after the last frame of its window. A transform
        that needs later frames, such as :class:`~torch_geometric_tactile.transforms.Resample` of
        complete trials, sets its attribute :obj:`causal` to :obj:`False`.
        """
        return self.preparation.causal

    @property
    def measures_rest(self) -> bool:
        r"""Whether a :class:`~torch_geometric_tactile.transforms.Tare` averages all readings that
        are passed to :meth:`adapt`. All of them must then be at rest.
        """
        return self.preparation.session.measures_rest

    def to(self, device: torch.device | str) -> Self:
        r"""Moves the model and the preparation to a device.

        Args:
            device (torch.device or str): The device.
        """
        self.network.to(device)
        self.preparation.to(self.network.device, self.network.dtype)
        return self

    @property
    def model(self) -> Module:
        r"""The model, in evaluation mode."""
        return self.network.model

    @model.setter
    def model(self, model: Module) -> None:
        self.network.model = model

    @property
    def class_names(self) -> tuple[str, ...]:
        r"""The names of the classes or labels; empty if they only have numbers."""
        return self.network.class_names

    @class_names.setter
    def class_names(self, names: tuple[str, ...]) -> None:
        self.network.class_names = names

    @property
    def task(self) -> Task:
        r"""The task: :obj:`"multiclass"`, :obj:`"multilabel"` or :obj:`"regression"`."""
        return self.network.task

    @task.setter
    def task(self, task: Task) -> None:
        self.network.task = task

    @property
    def threshold(self) -> float | None:
        r"""For two classes, the probability of class 1 above which :meth:`labels` returns class 1.
        :obj:`None` means one half.
        """
        return self.network.threshold

    @threshold.setter
    def threshold(self, threshold: float | None) -> None:
        self.network.threshold = threshold

    @property
    def score(self) -> MeasuredScore | None:
        r"""The score of the model on held-out samples, if it was measured."""
        return self.network.score

    @score.setter
    def score(self, score: MeasuredScore | None) -> None:
        self.network.score = score

    @property
    def contact(self) -> ContactRule | None:
        r"""The rule that detects frames and windows without contact, or :obj:`None`."""
        return self.preparation.contact

    @contact.setter
    def contact(self, rule: ContactRule | None) -> None:
        self.preparation.contact = rule

    def logits(self, data: StaticData) -> Tensor:
        r"""Returns the output of the model for prepared data :math:`(B, C)`, with gradients.

        Args:
            data (StaticData): Samples from :meth:`prepare` or :meth:`prepare_samples`.
        """
        return self.network.logits(data)

    def probability(self, logits: Tensor) -> Tensor:
        r"""Returns the probabilities of the classes or labels. For a regression, returns the
        numbers unchanged.

        Args:
            logits (torch.Tensor): Output of the model :math:`(B, C)`.
        """
        return self.network.probability(logits)

    def names(self, num_outputs: int) -> list[str]:
        r"""Returns the names of the outputs: the names of the classes or labels, or their numbers
        if there are no names.

        Args:
            num_outputs (int): Number of outputs :math:`C`.

        Raises:
            ValueError: If the number of names is not :obj:`num_outputs`.
        """
        return self.network.names(num_outputs)

    def labels(self, probability: Tensor, lacks_contact: Tensor | None = None) -> list[list[str]]:
        r"""Returns the predicted labels of each frame: the most probable class or, with a
        :obj:`threshold`, the class that the threshold selects. A multilabel task returns all labels
        with a probability above one half. Frames with NaN probabilities have no label. Frames
        without contact have the label :obj:`"no contact"`.

        Args:
            probability (torch.Tensor): The probabilities :math:`(C,)` or :math:`(B, C)`.
            lacks_contact (torch.Tensor, optional): The mask of frames without contact from
                :meth:`lacks_contact` :math:`(B,)`. By default, all frames are assumed to have
                contact.

        Raises:
            ValueError: If :obj:`task` is :obj:`"regression"` and :obj:`lacks_contact` is left out,
                or if there is a :obj:`threshold` and the number of classes is not two.
        """
        return self.network.labels(probability, lacks_contact)

    def prepare(
        self, reading: ArrayLike, joint: ArrayLike | None = None, session: int | None = None
    ) -> StaticData:
        r"""Returns readings after all transforms, as input of the model.

        Args:
            reading (torch.Tensor or numpy.ndarray): Raw readings, as for a call.
            joint (torch.Tensor or numpy.ndarray, optional): Joint angles, as for a call.
            session (int, optional): Number of the session, as for a call.
        """
        return self.preparation.prepare(reading, joint, session)

    def prepare_samples(self, data: StaticData) -> StaticData:
        r"""Returns samples of a data set after its :obj:`transform`, as input of the model.

        Args:
            data (StaticData): The samples, after the :obj:`pre_transform` of the data set and
                before its :obj:`transform`.
        """
        return self.preparation.prepare_samples(data)

    def prepare_frame(self, reading: ArrayLike, joint: ArrayLike | None = None) -> StaticData:
        r"""Returns one frame of a stream as input of the model. For a model that reads windows,
        only the transforms of frames are applied; see :meth:`prepare_window`.

        Args:
            reading (torch.Tensor or numpy.ndarray): Raw readings :math:`(N, C)`.
            joint (torch.Tensor or numpy.ndarray, optional): Joint angles in radians :math:`(J,)`.
        """
        return self.preparation.prepare_frame(reading, joint)

    def prepare_window(self, frame: StaticData, window: Tensor) -> StaticData:
        r"""Returns a window of a stream as input of the model.

        Args:
            frame (StaticData): The last frame of the window, from :meth:`prepare_frame`.
            window (torch.Tensor): Readings of the prepared frames :math:`(N, C \cdot T)`, in the
                order of :func:`~torch_geometric_tactile.data.join_frames`.
        """
        return self.preparation.prepare_window(frame, window)

    def windows(self, recording: Recording, *, resample: bool = False) -> tuple[StaticData, Tensor]:
        r"""Returns the windows of a recording and the index of the last frame of each window
        :math:`(W,)`. Windows are selected and cut as in training. The transforms of windows are not
        applied.

        Args:
            recording (Recording): The recording.
            resample (bool): Whether to resample a recording with another frame rate. The indices
                then count the frames of
                :meth:`Recording.resample <torch_geometric_tactile.data.Recording.resample>`.

        Raises:
            ValueError: If the model reads single frames, or for the reasons listed in
                :meth:`recording`.
        """
        return self.preparation.windows(recording, resample=resample)

    def adapt(
        self,
        reading: ArrayLike,
        joint: ArrayLike | None = None,
        time: ArrayLike | None = None,
    ) -> int:
        r"""Measures a new recording session from some of its readings, which need no labels.
        Returns the number of the session. Later calls use this session by default. See
        :class:`~torch_geometric_tactile.transforms.SessionZScore` and
        :class:`~torch_geometric_tactile.transforms.Tare`.

        If no transform measures sessions, or a tare measures all readings, the rule
        :attr:`contact` uses the same readings as its readings at rest.

        Args:
            reading (torch.Tensor or numpy.ndarray): Raw readings :math:`(B, N, F)`. For a model
                that reads windows, pass windows, or frames if a transform of frames measures the
                session.
            joint (torch.Tensor or numpy.ndarray, optional): Joint angles in radians.
            time (torch.Tensor or numpy.ndarray, optional): Time of each reading in seconds
                :math:`(B,)`, if :class:`~torch_geometric_tactile.transforms.Tare` needs it.

        Raises:
            ValueError: If nothing measures sessions, or for the reasons listed in
                :class:`Predictor`.
        """
        return self.preparation.session.adapt(reading, joint, time)

    def adapt_recording(
        self, recording: Recording, *, rest: float | None = None, resample: bool = False
    ) -> int:
        r"""Measures a new recording session from a recording, and returns the number of the
        session. This works for models that read frames or windows. The frames are selected as in
        training.

        Args:
            recording (Recording): The recording, or its first seconds.
            rest (float, optional): Seconds at the start in which nothing touches the sensor.
                :class:`~torch_geometric_tactile.transforms.Tare` and :attr:`contact` measure all of
                these frames. By default, they measure as many frames as in training.
            resample (bool): Whether to resample a recording with another frame rate.

        Raises:
            ValueError: If nothing measures sessions, or for the reasons listed in
                :meth:`recording`.
        """
        return self.preparation.session.adapt_recording(recording, rest=rest, resample=resample)

    def adapt_windows(self, windows: StaticData) -> int:
        r"""Measures a new recording session from windows, and returns the number of the session.

        Args:
            windows (StaticData): Windows from :meth:`windows`.

        Raises:
            ValueError: If nothing measures sessions, or a transform measures them on frames.
        """
        return self.preparation.session.adapt_windows(windows)

    def __call__(
        self,
        reading: ArrayLike,
        joint: ArrayLike | None = None,
        session: int | None = None,
    ) -> Tensor:
        r"""Returns the probabilities of the classes or labels.

        Args:
            reading (torch.Tensor or numpy.ndarray): One reading :math:`(N, F)` or several readings
                :math:`(B, N, F)`; for a model that reads windows, windows.
            joint (torch.Tensor or numpy.ndarray, optional): Joint angles in radians, one row for
                all readings :math:`(J,)` or one row per reading :math:`(B, J)`.
            session (int, optional): Number of the session from :meth:`adapt`. Defaults to the last
                session.
        """
        with torch.inference_mode():
            out = self.probability(self.logits(self.prepare(reading, joint, session)))
        if self.contact is not None:
            out = _mask_probability(out, self.preparation.lacks_contact(reading))
        return out[0] if len(array_shape(reading)) == 2 else out

    def with_tare(self) -> Self:
        r"""Returns a copy of this predictor for raw readings. Use it if the predictor was trained
        on readings relative to rest, such as readings of :obj:`AllegroUSkin(tare="hover")`. The
        first transform of the copy is a :class:`~torch_geometric_tactile.transforms.Tare`;
        :meth:`adapt` measures the readings at rest.

        Raises:
            ValueError: If a transform already measures sessions, or if a transform is applied
                before windows are cut.
        """
        return self._from_parts(add_tare(self.preparation), copy.deepcopy(self.network))

    def recording(
        self, recording: Recording, batch_size: int = 256, *, resample: bool = False
    ) -> Tensor:
        r"""Returns the probabilities of all frames of a recording :math:`(T, C)`. For a model that
        reads windows, returns the probabilities of its windows :math:`(W, C)`, which are selected
        and cut as in training.

        Args:
            recording (Recording): The recording. It must be tared if the training recordings were.
            batch_size (int): Number of frames or windows that are computed at a time.
            resample (bool): For a model that reads windows, whether to resample a recording with
                another frame rate than the training data.

        Raises:
            ValueError: If the taxels, channels, joints, column names, unit or frame rate of the
                recording differ from the training data, or if it has too few frames for a window.
        """
        preparation = self.preparation
        if self.window is not None:
            recording = preparation.match_recording(recording, resample=resample)
            windows, last = preparation.cut_recording(recording)
            out = self.of_windows(windows, batch_size)
            if self.contact is None:
                return out
            return _mask_probability(out, preparation.windows_lacking_contact(recording, last))
        _check_batch_size(batch_size)
        recording = preparation.match_recording(recording)
        # There is at least one chunk, so that an empty recording has an output (0, C).
        starts = range(0, max(recording.num_frames, 1), batch_size)
        chunks = [recording.select(slice(start, start + batch_size)) for start in starts]
        return torch.cat([self(chunk.tactile, chunk.joint) for chunk in chunks])

    def lacks_contact(self, reading: ArrayLike | Recording, *, resample: bool = False) -> Tensor:
        r"""Returns a mask of the frames without contact, by the rule :attr:`contact`. For a model
        that reads windows, returns a mask of the windows in which no frame has contact. The
        probabilities of these frames or windows are NaN, and :meth:`labels` returns
        :obj:`"no contact"`. Without a rule, all frames have contact.

        Args:
            reading (Recording or torch.Tensor or numpy.ndarray): A recording, or readings as for a
                call.
            resample (bool): As in :meth:`recording`.

        Shapes:
            - **output:** :math:`(T,)` for frames, :math:`(W,)` for windows

        Raises:
            ValueError: If the rule has no readings at rest, or for the reasons of a call.
        """
        preparation = self.preparation
        if not isinstance(reading, Recording):
            return preparation.lacks_contact(reading)
        recording = preparation.match_recording(reading, resample=resample)
        if self.window is None:
            return preparation.lacks_contact(recording.tactile)
        last = preparation.cut_recording(recording)[1]
        return preparation.windows_lacking_contact(recording, last)

    def of_windows(self, windows: StaticData, batch_size: int = 256) -> Tensor:
        r"""Returns the probabilities of windows :math:`(W, C)`. Windows without contact are not
        masked, because the rule :attr:`contact` needs raw readings.

        Args:
            windows (StaticData): Windows from :meth:`windows`.
            batch_size (int): Number of windows that are computed at a time.

        Raises:
            ValueError: If :obj:`batch_size` is below one.
        """
        _check_batch_size(batch_size)
        self.preparation.session.set_session_number(windows)
        probabilities = []
        with torch.inference_mode():
            for start in range(0, windows.num_samples, batch_size):
                batch = windows.index_select(slice(start, start + batch_size))
                data = self.preparation.apply_sample_transforms(batch)
                probabilities.append(self.probability(self.logits(data)))
        return torch.cat(probabilities)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({type(self.model).__name__}, '{self.layout.name}', "
            f"classes={list(self.class_names)}, task='{self.task}')"
        )


def _mask_probability(probability: Tensor, lacks_contact: Tensor) -> Tensor:
    r"""Returns probabilities with NaN in the rows without contact, so that programs do not use them
    as predictions.

    Shapes:
        - **probability:** :math:`(B, C)`
        - **lacks_contact:** :math:`(B,)`
    """
    is_missing = lacks_contact.to(probability.device).unsqueeze(1)
    return probability.masked_fill(is_missing, torch.nan)


def _check_batch_size(size: int) -> None:
    need(size >= 1, "'batch_size' must be at least 1", size)
