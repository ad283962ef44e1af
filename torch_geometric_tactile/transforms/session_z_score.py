r"""Scaling of readings within each recording session."""

from typing import Literal

from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms.base import FittedTransform


@functional_transform("session_z_score")
class SessionZScore(FittedTransform):
    r"""Scales each taxel and channel to mean zero and standard deviation one within each recording
    session, without labels (functional name: :obj:`session_z_score`). It removes offsets and gains
    of a sensor that differ from day to day.

    It needs the readings of a session before the first one can be scaled. It assumes that sessions
    differ in the sensor, not in the touched objects: a session of stable grasps only would be
    scaled to the same distribution as other sessions. See the page on session scaling in the
    documentation.

    :meth:`fit` measures the sessions of the training part, and :meth:`adapt` new sessions.

    Args:
        key (str): Integer attribute of the samples with the number of the session.
        attr (str): The attribute to scale: :obj:`"x"`, or another attribute of floating-point
            numbers.
        per (str): :obj:`"taxel"` for a centre and a scale of each taxel and channel,
            :obj:`"channel"` for those of all taxels of a channel (the last dimension of
            :obj:`attr`), or :obj:`"signal"` for those of all frames of a taxel and channel, in
            windows.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`, with sessions :math:`(B,)`
        - **output:** the same shape

    Raises:
        RuntimeError: If it was not fitted.
        ValueError: If :obj:`per` is unknown, a session was not measured, or the readings have other
            taxels (unless :obj:`per="channel"`) or channels.

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
