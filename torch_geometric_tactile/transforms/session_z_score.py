r"""Scaling by recording session."""

from typing import Literal

from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms.base import FittedTransform


@functional_transform("session_z_score")
class SessionZScore(FittedTransform):
    r"""Scales each taxel and channel to mean zero and standard deviation one within each recording
    session, without labels (functional name: :obj:`session_z_score`). It removes the offset and
    gain of a sensor that differ from day to day.

    It needs the readings of a session before the first of them can be scaled, and assumes that
    sessions differ in their sensor and not in what was touched: a session of stable grasps only
    would be scaled to look like any other. See the page on session scaling in the documentation.

    :meth:`fit` measures the sessions of the training part, :meth:`adapt` those that are new.

    Args:
        key (str): Integer attribute of the samples that numbers the session.
        attr (str): What is scaled: :obj:`"x"`, or another attribute of floating-point numbers.
        per (str): :obj:`"taxel"` for a centre and a scale of each taxel and channel, or
            :obj:`"channel"` for one of all taxels of a channel: the last dimension of :obj:`attr`,
            or :obj:`"signal"` for one of all frames of a taxel and channel, in windows.

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
