r"""Scaling of readings within each recording session."""

from typing import Literal

from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms.base import FittedTransform


@functional_transform("session_z_score")
class SessionZScore(FittedTransform):
    r"""Scales each taxel and channel to mean zero and standard deviation one within each recording
    session (functional name: :obj:`session_z_score`). Use it to remove offsets and gains of a
    sensor that differ from day to day. It does not need labels.

    A session must be recorded before its first reading can be scaled. The transform assumes that
    sessions differ in the sensor, not in the touched objects: it would scale a session that has
    only stable grasps to the same distribution as other sessions. See the page on session scaling
    in the documentation.

    Call :meth:`fit` for the sessions of the training part and :meth:`adapt` for new sessions.

    Args:
        key (str): Integer attribute of the samples with the number of the session.
        attr (str): The attribute to scale: :obj:`"x"`, or another attribute of floating-point
            numbers.
        per (str): The numbers of a session that share a mean and a scale:

            * :obj:`"taxel"`: each taxel and channel has a separate mean and scale.
            * :obj:`"channel"`: all taxels of a channel (the last dimension of :obj:`attr`) share
              them.
            * :obj:`"signal"`: all frames of a taxel and channel in a window share them.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`, with sessions :math:`(B,)`
        - **output:** the same shape

    Raises:
        RuntimeError: If the transform was not fitted.
        ValueError: If :obj:`per` is unknown, a session was not fitted, or the readings have
            different taxels (except with :obj:`per="channel"`) or channels than the fitted samples.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.data import StaticData
        >>> x = torch.tensor([1.0, 3.0, 101.0, 103.0]).view(4, 1, 1)
        >>> data = StaticData(x=x, session=torch.tensor([0, 0, 1, 1]))
        >>> SessionZScore().fit(data)(data).x.view(-1)
        tensor([-1.,  1., -1.,  1.])
    """

    def __init__(
        self,
        key: str = "session",
        attr: str = "x",
        per: Literal["taxel", "channel", "signal"] = "taxel",
    ) -> None:
        super().__init__(key, attr=attr, per=per)

    def __repr__(self) -> str:
        return f"{type(self).__name__}('{self.key}'{self._attr_repr()})"
