r"""Readings relative to rest."""

from torch_geometric_tactile.transforms.base import FittedTransform


class Tare(FittedTransform):
    r"""Subtracts the rest reading of each taxel and channel: the mean over the first samples of its
    session (or trial), when nothing is touched yet.

    Where nothing was recorded at rest, the mean over the whole session stands in for it
    (:obj:`first=None`); it takes out the sensor's offset, and the mean touch with it.

    Args:
        key (str): Integer attribute of the samples within which the rest reading holds, such as
            :obj:`"session"` or :obj:`"trial"`.
        first (int, optional): Number of samples at rest that each session begins with. All samples
            if left out.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`, with sessions :math:`(B,)`
        - **output:** the same shape, in the same unit

    Raises:
        RuntimeError: If it was not fitted.
        ValueError: If :obj:`first` is below one, a session was not measured, or the readings have
            other taxels or channels.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.data import StaticData
        >>> x = torch.tensor([10.0, 15.0, 20.0, 21.0]).view(4, 1, 1)
        >>> data = StaticData(x=x, trial=torch.tensor([0, 0, 1, 1]))
        >>> Tare("trial", first=1).fit(data)(data).x.view(-1)
        tensor([0., 5., 0., 1.])
    """

    def __init__(self, key: str = "session", first: int | None = None) -> None:
        if first is not None and first < 1:
            raise ValueError(f"'first' must be at least 1 (got {first})")
        super().__init__(key, unit_scale=True, first=first)

    def __repr__(self) -> str:
        return f"{type(self).__name__}('{self.key}', first={self.first})"
